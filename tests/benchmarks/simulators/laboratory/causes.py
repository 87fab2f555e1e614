"""What a laboratory may hide, in its own terms: names, what the library calls the same,
and circumstances.

A cause grows from absent to `full`; how large it is hidden is sought later, in
millimetres at the tip. Settings are fields of `Rod`, `Hand` and `Sight`, by name with
these in front.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.simulators.laboratory.rod import Rod

Values = dict[str, float]
THICK = 0.04  # [m], radius of the thickest peg
PLACES = 50  # that are tried for one
CLEAR = 0.012  # [m] that a plane keeps from the hand and from the string at rest


@dataclass(frozen=True)
class Plain:
    """Trials without any cause. times: (F,) of each [s]. strings: (F, S, 2) [m], the
    first point at the grasp. hands: (K, 2) everywhere where the hand is [m].
    """

    rod: Rod
    times: tuple[np.ndarray, ...]
    strings: tuple[np.ndarray, ...]
    hands: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Hidden:
    """A cause in circumstances. absent, full: settings at either end. only: the one
    trial in which it acts, or None.
    """

    cause: Cause
    absent: Values
    full: Values
    only: int | None = None

    def at(self, share: float) -> Values:
        """Settings at a share of the way from absent to full."""
        return {
            name: self.absent[name] + share * (end - self.absent[name])
            for name, end in self.full.items()
        }


Ends = tuple[Values, Values]
Draw = Callable[[np.random.Generator, Plain, int], Ends | None]


@dataclass(frozen=True)
class Cause:
    """A cause that may be hidden. library: the library's names for it, any of which is
    right; none: it is outside.

    draw: from chance, plain trials and the trial in which it acts to settings absent
    and full, or None where there are no such circumstances. comparable: parameters of
    the library that mean the same, from settings. once: it acts in one trial only.
    ways: circumstances in which it is tried against an outside cause that it could pass
    for. larger: how many times larger than others it is hidden, where an effect of the
    library explains most of it.
    """

    name: str
    library: tuple[str, ...]
    draw: Draw
    comparable: Callable[[Mapping[str, float]], Values] = lambda values: {}
    once: bool = False
    ways: int = 1
    larger: float = 1.0

    def hidden(self, rng: np.random.Generator, plain: Plain) -> Hidden | None:
        """The cause in circumstances that fit the trials; None where there are none."""
        trial = int(rng.integers(len(plain.times)))
        ends = self.draw(rng, plain, trial)
        return (
            None
            if ends is None
            else Hidden(self, *ends, only=trial if self.once else None)
        )


def sized(name: str, *ends: float, **others: tuple[float, float]) -> Draw:
    """A size that grows to one of its ends; others are drawn evenly from their ranges."""

    def draw(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
        world = name.split(".", maxsplit=1)[0]
        same = {
            f"{world}.{other}": float(rng.uniform(*span))
            for other, span in others.items()
        }
        return {name: 0.0, **same}, {name: float(rng.choice(ends)), **same}

    return draw


def pointing(x: str, y: str, size: float, **others: tuple[float, float]) -> Draw:
    """A vector that grows in any direction."""

    def draw(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
        towards = rng.uniform(-np.pi, np.pi)
        world = x.split(".", maxsplit=1)[0]
        same = {
            f"{world}.{other}": float(rng.uniform(*span))
            for other, span in others.items()
        }
        full = {x: size * float(np.cos(towards)), y: size * float(np.sin(towards))}
        return {x: 0.0, y: 0.0, **same}, {**full, **same}

    return draw


def during(
    draw: Draw,
    when: str,
    lasts: str | None = None,
    span: tuple[float, float] = (0.06, 0.15),
) -> Draw:
    """A cause that acts from some time of the trial on, and to another if it ends."""

    def timed(rng: np.random.Generator, plain: Plain, trial: int) -> Ends | None:
        ends = draw(rng, plain, trial)
        begin = float(rng.uniform(0.25, 0.6) * plain.times[trial][-1])
        same = {when: begin} | (
            {lasts: begin + float(rng.uniform(*span))} if lasts else {}
        )
        return ends and (ends[0] | same, ends[1] | same)

    return timed


def passed(draw: Draw, x: str, y: str) -> Draw:
    """A cause at a place which the outer half of the string passes once it moves."""

    def placed(rng: np.random.Generator, plain: Plain, trial: int) -> Ends | None:
        ends = draw(rng, plain, trial)
        string = plain.strings[trial]
        frame = int(rng.uniform(0.3, 0.7) * len(string))
        place = string[frame, rng.integers(string.shape[1] // 2, string.shape[1])]
        same = {x: float(place[0]), y: float(place[1])}
        return ends and (ends[0] | same, ends[1] | same)

    return placed


def _gravity(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """A base that is not level. Its components do not change evenly with the angle, but
    nearly.
    """
    tilt = 0.3 * float(rng.choice([-1, 1]))
    return {"rod.gravity_x": 0.0}, {"rod.gravity_x": 9.81 * tilt}


def _hardening(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """Stiffening, or yielding: where M = B k (1 + |h| k^2)^(+-1/2) is half as much
    again, or two thirds, at 20 /m.
    """
    return {"rod.hardening": 0.0}, {"rod.hardening": 6e-3 * float(rng.choice([-1, 1]))}


def _rub(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """Up to a moment as large as the bending stiffness has at 20 /m."""
    same = {"rod.rub_curvature": float(np.exp(rng.uniform(*np.log([0.5, 3.0]))))}
    return {"rod.rub": 0.0, **same}, {"rod.rub": 20 * plain.rod.bending, **same}


def _relaxing(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """Up to five times the stiffness that stays, for a good part of a trial."""
    same = {"rod.relaxation": float(np.exp(rng.uniform(*np.log([0.05, 0.3]))))}
    return {"rod.relaxing": 0.0, **same}, {
        "rod.relaxing": 5 * plain.rod.bending,
        **same,
    }


def _backlash(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """Play in one joint, or in each by a share of its own."""
    shares = np.eye(3)[rng.integers(3)] if rng.integers(2) else rng.uniform(size=3)
    full = {
        f"hand.gap_{joint + 1}": 0.1 * float(share)
        for joint, share in enumerate(shares)
    }
    return dict.fromkeys(full, 0.0), full


def _slip(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """Either way, within the movement of the shortest trial."""
    shortest = min(t[-1] for t in plain.times)
    begin = float(rng.uniform(0.2, 0.5) * shortest)
    same = {
        "hand.slip_from": begin,
        "hand.slip_until": begin + float(rng.uniform(0.1, 1.0) * shortest),
    }
    return {"hand.slip": 0.0, **same}, {
        "hand.slip": 0.3 * float(rng.choice([-1, 1])),
        **same,
    }


def _plane(rng: np.random.Generator, plain: Plain, trial: int) -> Ends | None:
    """A floor or a wall, from where the string just touches it to where the hand or the
    string at rest would.
    """
    tilt = float(rng.uniform(-np.pi, np.pi))
    normal = np.array([-np.sin(tilt), np.cos(tilt)])
    touched = min(float((points @ normal).min()) for points in plain.strings)
    kept = min(float((points[0] @ normal).min()) for points in plain.strings)
    kept = min(kept, *(float((way @ normal).min()) for way in plain.hands)) - CLEAR
    if kept - touched < 0.03:
        return None
    hard = float(np.exp(rng.uniform(*np.log([3e4, 6e5]))))
    same = {
        "rod.plane": hard,
        "rod.plane_x": float(normal[0]),
        "rod.plane_y": float(normal[1]),
    }
    same |= {
        "rod.plane_friction": float(rng.uniform(0, 0.5)),
        "rod.plane_loss": float(rng.uniform(0, 60)),
    }
    return {"rod.plane_height": touched, **same}, {"rod.plane_height": kept, **same}


def _peg(rng: np.random.Generator, plain: Plain, trial: int) -> Ends | None:
    """A round peg, ever thicker, where the string comes by, well away from the hand and
    the string's beginning.
    """
    kept = np.concatenate([plain.strings[trial][0], plain.hands[trial]])
    hard = {"rod.peg": float(np.exp(rng.uniform(*np.log([3e4, 3e5]))))}
    for _ in range(PLACES):
        ends = passed(sized("rod.peg_radius", THICK), "rod.peg_x", "rod.peg_y")(
            rng, plain, trial
        )
        assert ends is not None
        centre = np.array([ends[0]["rod.peg_x"], ends[0]["rod.peg_y"]])
        if np.linalg.norm(kept - centre, axis=-1).min() > THICK + CLEAR:
            return ends[0] | hard, ends[1] | hard
    return None


def _thread(rng: np.random.Generator, plain: Plain, trial: int) -> Ends:
    """A thread from the tip to where it hangs first, that goes taut after half of its
    farthest way.
    """
    tips = plain.strings[trial][:, -1]
    slack = 0.5 * float(np.linalg.norm(tips - tips[0], axis=-1).max())
    same = {
        "rod.thread_x": float(tips[0, 0]),
        "rod.thread_y": float(tips[0, 1]),
        "rod.thread_slack": slack,
    }
    return {"rod.thread": 0.0, **same}, {"rod.thread": 3e3, **same}


def _one(
    setting: str, parameter: str, factor: float = 1.0
) -> Callable[[Mapping[str, float]], Values]:
    """One setting that is a parameter of the library."""
    return lambda values: {parameter: factor * values[setting]}


CAUSES = (
    Cause(
        "tip_mass",
        ("tip_mass",),
        sized("rod.tip_mass", 0.6),
        _one("rod.tip_mass", "tip_mass.ratio"),
    ),
    Cause(
        "taper",
        ("density_taper",),
        sized("rod.taper", -1.5, 1.5),
        _one("rod.taper", "density_taper.taper"),
    ),
    Cause(
        "set",
        ("rest_curvature",),
        sized("rod.set_curvature", -20.0, 20.0),
        _one("rod.set_curvature", "rest_curvature.curvature"),
    ),
    Cause("hardening", ("nonlinear_bending",), _hardening),
    # of Bouc and Wen: neither reaches its moment as that does
    Cause("rub", ("maxwell_slip", "dahl_friction"), _rub),
    Cause(
        "relaxing",
        ("standard_linear_solid",),
        _relaxing,
        lambda values: {
            "standard_linear_solid.stiffness": values["rod.relaxing"],
            "standard_linear_solid.relaxation": values["rod.relaxation"],
        },
    ),
    Cause("across", ("anisotropic_drag",), sized("rod.across", 8.0)),
    Cause(
        "wind",
        ("wind",),
        pointing("rod.wind_x", "rod.wind_y", 5.0),
        lambda values: {
            "wind.along_x": values["rod.wind_x"],
            "wind.along_y": values["rod.wind_y"],
        },
        ways=2,
    ),
    Cause(
        "gravity",
        ("gravity_direction",),
        _gravity,
        lambda values: {
            "gravity_direction.tilt": float(np.arctan2(values["rod.gravity_x"], 9.81))
        },
    ),
    Cause(
        "plane",
        ("contact",),
        _plane,
        lambda values: {
            "contact.height": values["rod.plane_height"],
            "contact.tilt": float(
                np.arctan2(-values["rod.plane_x"], values["rod.plane_y"])
            ),
        },
        ways=3,
    ),
    Cause(
        "lag",
        ("arm_lag",),
        sized("hand.lag", 0.08),
        _one("hand.lag", "arm_lag.time_constant"),
    ),
    Cause(
        "gain",
        ("joint_gain",),
        sized("hand.gain", -0.2, 0.2),
        _one("hand.gain", "joint_gain.gain"),
    ),
    Cause(
        "play",
        ("backlash",),
        _backlash,
        lambda values: {
            f"backlash.gap_{j}": values[f"hand.gap_{j}"] for j in (1, 2, 3)
        },
        ways=3,
    ),
    Cause(
        "angle",
        ("grasp_angle",),
        sized("hand.angle", -0.8, 0.8),
        _one("hand.angle", "grasp_angle.angle"),
    ),
    Cause(
        "slip",
        ("grasp_slip",),
        _slip,
        lambda values: {
            "grasp_slip.speed": values["hand.slip"],
            "grasp_slip.onset": values["hand.slip_from"],
        },
        ways=2,
    ),
    Cause(
        "offset",
        ("time_offset",),
        sized("sight.offset", -0.05, 0.05),
        _one("sight.offset", "time_offset.offset"),
    ),
    Cause(
        "drift",
        ("clock_drift",),
        sized("sight.drift", -0.05, 0.05),
        _one("sight.drift", "clock_drift.rate"),
    ),
    Cause(
        "roll",
        ("camera_rotation",),
        sized("sight.roll", -0.2, 0.2),
        _one("sight.roll", "camera_rotation.angle"),
    ),
    Cause(
        "scale",
        ("pixel_scale",),
        sized("sight.scale", -0.1, 0.1),
        _one("sight.scale", "pixel_scale.excess"),
    ),
    # by division: no one polynomial is as that
    Cause("lens", ("lens_distortion",), sized("sight.lens", -0.2, 0.2)),
    Cause(
        "readout",
        ("rolling_shutter",),
        sized("sight.readout", -0.02, 0.02),
        _one("sight.readout", "rolling_shutter.readout"),
    ),
    # outside the library
    Cause("stiffness_taper", (), sized("rod.stiffness_taper", -1.8, 1.8)),
    Cause("soft_spot", (), sized("rod.soft_loss", 0.95, soft_place=(0.3, 0.7))),
    Cause("bead", (), sized("rod.bead_mass", 1.0, bead_place=(0.35, 0.7))),
    Cause("flag", (), sized("rod.flag", 1.0)),
    Cause("crisis", (), sized("rod.crisis", 0.95, crisis_speed=(1.5, 4.0))),
    Cause(
        "flutter",
        (),
        pointing("rod.flutter_x", "rod.flutter_y", 12.0, flutter_frequency=(2.0, 8.0)),
    ),
    Cause(
        "letting_go", (), during(sized("rod.grasp_loss", 60.0), "rod.grasp_loss_from")
    ),
    Cause(
        "pull",
        (),
        passed(
            sized("rod.pull", -300.0, 300.0, pull_reach=(0.05, 0.12)),
            "rod.pull_x",
            "rod.pull_y",
        ),
    ),
    Cause(
        "eddy",
        (),
        passed(
            sized("rod.eddy", -25.0, 25.0, eddy_core=(0.08, 0.2)),
            "rod.eddy_x",
            "rod.eddy_y",
        ),
    ),
    Cause("peg", (), _peg, once=True),
    Cause("thread", (), _thread, once=True),
    Cause(
        "gust",
        (),
        during(
            pointing("rod.gust_x", "rod.gust_y", 25.0, gust_lasts=(0.04, 0.1)),
            "rod.gust_when",
        ),
        once=True,
    ),
    Cause(
        "blow",
        (),
        during(
            pointing("rod.blow_x", "rod.blow_y", 1500.0, blow_place=(0.45, 0.9)),
            "rod.blow_when",
        ),
        once=True,
    ),
    Cause(
        "hold",
        (),
        during(
            sized("rod.hold", 2e3, hold_place=(0.4, 0.9)),
            "rod.hold_from",
            "rod.hold_until",
        ),
        once=True,
    ),
    Cause("stick", (), during(sized("hand.stick", 0.15), "hand.stick_from"), once=True),
    Cause("askew_joint", (), sized("hand.askew", -0.15, 0.15)),
    Cause("ringing", (), sized("hand.ringing", 1.5e-3)),
    Cause("link", (), sized("hand.link", -0.05, 0.05)),
    Cause(
        "shaken_base",
        (),
        sized(
            "hand.shake", 0.02, shake_towards=(-3.1, 3.1), shake_frequency=(4.0, 12.0)
        ),
    ),
    Cause(
        "jump",
        (),
        during(sized("sight.jump", -0.05, 0.05), "sight.jump_when"),
        once=True,
    ),
    Cause(
        "bump",
        (),
        during(pointing("sight.bump_x", "sight.bump_y", 0.05), "sight.bump_when"),
        once=True,
    ),
    Cause(
        "shaken_camera",
        (),
        pointing("sight.shake_x", "sight.shake_y", 0.03, shake_frequency=(4.0, 15.0)),
    ),
    Cause(
        "askew_camera", (), pointing("sight.askew_x", "sight.askew_y", 0.25), larger=4.0
    ),
    Cause("stretch", (), sized("sight.stretch", -0.1, 0.1)),
    Cause("misread", (), sized("sight.misread", -0.12)),
)
NAMED = {cause.name: cause for cause in CAUSES}
