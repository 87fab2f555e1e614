"""How an effect is hidden: its circumstances drawn, its size left open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.effect import Effect
from stringcast.stages.model.effects.backlash import Backlash
from tests.benchmarks.simulators.outside import Outside

CLEAR = 0.01  # [m] that a plane keeps from the hand and from the string at rest


@dataclass(frozen=True)
class Hidden:
    """An effect between absent and as large as its range allows.

    absent, full: its parameters by qualified name at either end. only: the one trial in
    which it acts, or None.
    """

    effect: type[Effect]
    absent: dict[str, float]
    full: dict[str, float]
    only: int | None = None

    def at(self, share: float) -> dict[str, float]:
        """Parameters of the effect at a share of the way from absent to full."""
        return {
            name: low + share * (self.full[name] - low)
            for name, low in self.absent.items()
        }


def hidden(
    effect: type[Effect],
    rng: np.random.Generator,
    times: list[np.ndarray],
    strings: list[np.ndarray],
) -> Hidden | None:
    """The effect in circumstances that fit the trials, or None where there are none.

    times: (F,) of each trial [s]. strings: (F, n, 2), the string without it [m].
    """
    size, *others = effect.parameters
    low_or_high = [end for end in (size.low, size.high) if end != size.start]
    only, ends = None, None
    if issubclass(effect, Outside):
        # in one trial or in all of them, with circumstances from the trial in which it
        # acts
        trial = int(rng.integers(len(times)))
        same = effect.circumstances(rng, times[trial], strings[trial])
        ends = (
            {size.name: 0.0, **same},
            {size.name: float(rng.choice(low_or_high)), **same},
        )
        only = trial if effect.once else None
    elif effect.name in SPECIAL:
        ends = SPECIAL[effect.name](rng, times, strings)
    else:
        # its first parameter towards either end of its range; others, if it has any,
        # somewhere in theirs
        same = {p.name: float(p.value(np.asarray(rng.uniform()))) for p in others}
        ends = (
            {size.name: size.start, **same},
            {size.name: float(rng.choice(low_or_high)), **same},
        )
    if ends is None:
        return None
    absent, full = (
        {f"{effect.name}.{name}": value for name, value in end.items()} for end in ends
    )
    return Hidden(effect, absent, full, only)


Ends = tuple[dict[str, float], dict[str, float]]


def _wind(
    rng: np.random.Generator, times: list[np.ndarray], strings: list[np.ndarray]
) -> Ends:
    """From anywhere."""
    towards = rng.uniform(-np.pi, np.pi)
    return {"along_x": 0.0, "along_y": 0.0}, {
        "along_x": 5 * float(np.cos(towards)),
        "along_y": 5 * float(np.sin(towards)),
    }


def _rest_curvature(
    rng: np.random.Generator, times: list[np.ndarray], strings: list[np.ndarray]
) -> Ends:
    """A curvature that is uniform along the string, as in all benches that were
    recorded.
    """
    return {"curvature": 0.0, "slope": 0.0}, {
        "curvature": float(rng.choice([-20.0, 20.0])),
        "slope": 0.0,
    }


def _backlash(
    rng: np.random.Generator, times: list[np.ndarray], strings: list[np.ndarray]
) -> Ends:
    """Play in one joint, or in each by a share of its own."""
    shares = np.eye(3)[rng.integers(3)] if rng.integers(2) else rng.uniform(size=3)
    gaps = {
        p.name: p.high * float(share)
        for p, share in zip(Backlash.parameters, shares, strict=True)
    }
    return dict.fromkeys(gaps, 0.0), gaps


def _grasp_slip(
    rng: np.random.Generator, times: list[np.ndarray], strings: list[np.ndarray]
) -> Ends:
    """Either way, from some time on within the first half of the shortest movement, to
    its end or not so long.
    """
    shortest, speed = min(t[-1] for t in times), 0.3 * float(rng.choice([-1, 1]))
    same = {
        "onset": float(rng.uniform(0.2, 0.5) * shortest),
        "duration": float(rng.uniform(0.1, 1.0) * shortest),
    }
    return {"speed": 0.0, **same}, {"speed": speed, **same}


def _contact(
    rng: np.random.Generator, times: list[np.ndarray], strings: list[np.ndarray]
) -> Ends | None:
    """A plane of any tilt, from where the string just touches it to where the hand or
    the string at rest would.
    """
    tilt = float(rng.uniform(-np.pi, np.pi))
    normal = np.array([-np.sin(tilt), np.cos(tilt)])
    touched = min(float((points @ normal).min()) for points in strings)
    kept = (
        min(
            float(min((points[:, 0] @ normal).min(), (points[0] @ normal).min()))
            for points in strings
        )
        - CLEAR
    )
    if kept - touched < 0.02 or max(abs(kept), abs(touched)) > 1:
        return None
    stiffness = float(np.exp(rng.uniform(*np.log([1e4, 4e6]))))
    loss, friction = float(rng.uniform(0, 0.4)), float(rng.uniform(0, 0.5))
    same = {"tilt": tilt, "stiffness": stiffness, "friction": friction, "loss": loss}
    return {"height": touched, **same}, {"height": kept, **same}


SPECIAL: dict[
    str,
    Callable[[np.random.Generator, list[np.ndarray], list[np.ndarray]], Ends | None],
] = {
    "wind": _wind,
    "rest_curvature": _rest_curvature,
    "backlash": _backlash,
    "grasp_slip": _grasp_slip,
    "contact": _contact,
}
