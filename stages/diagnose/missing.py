"""What would have to be there: pulses of force on the string, of motion of the grasp, or of shift of the picture.

Each kind is a family of smooth pulses that fill time (and the string). What a pulse does is
simulated once; the amplitudes then follow from the residual by ridge regression, trial by
trial. The kind that explains most with the fewest amplitudes says where to look.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import MISSING
from stringcast.stages.diagnose.differing import Differing
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.hypotheses import Hypotheses
from stringcast.stages.diagnose.noise import parts, systematic
from stringcast.stages.diagnose.pulses import GraspShift, PictureShift, Push
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.model import Model

EVERY = 0.04  # [s] from pulse to pulse
PLACES = (0.25, 0.5, 0.75, 1.0)  # of the string's length, of pulses of force
STEADY = 0.6  # of the mean size that the mean has, where the direction stays
MOST = 40  # pulses in time of a trial
UNSEEN = 1e-6  # of the most that a pulse does: nobody sees that
FIRMNESS = 0.1  # of the ridge, in units of what a typical pulse does
SIZES: Mapping[type[Effect], float] = {Push: 5.0, GraspShift: 2e-3, PictureShift: 2e-3}  # at which pulses are tried


@dataclass(frozen=True)
class Missing:
    """kind: what explains most. table: its amplitudes. explained: share of the systematic misfit by kind."""

    kind: str
    table: pd.DataFrame
    explained: Mapping[str, float]


def missing(hypotheses: Hypotheses, fit: Fit) -> Missing:
    """The best description of what is left by a fit."""
    trials = range(len(hypotheses.evidence.cases))
    found = {effect: [_of_trial(hypotheses.evidence, fit, effect, k) for k in trials] for effect in SIZES}
    left = {effect: [rest for rest, _ in parts] for effect, parts in found.items()}
    explained = {effect: _explained(hypotheses.evidence, fit, rest) for effect, rest in left.items()}
    best = max(explained, key=lambda effect: explained[effect])
    table = pd.concat([table for _, table in found[best]], ignore_index=True)
    return Missing(best.name, MISSING.check(table), {effect.name: share for effect, share in explained.items()})


def _explained(evidence: Evidence, fit: Fit, left: Sequence[np.ndarray]) -> float:
    """Share of the systematic misfit that is gone."""
    before = systematic(evidence, fit.residual)
    return float(1 - systematic(evidence, np.concatenate(left)) / before) if before > 0 else 0.0


def _of_trial(evidence: Evidence, fit: Fit, effect: type[Effect], number: int) -> tuple[np.ndarray, pd.DataFrame]:
    """What is left of a trial's residual (n,), and the amplitudes that were taken from it."""
    own = evidence.only([number])
    case, residual = own.cases[0], fit.residual[evidence.trial == number]
    model = fit.theory.model.with_effects(effect)
    pulses = _pulses(effect, case.times, model.string.length)
    chi = np.stack([_chi(model, fit, effect, pulse) for pulse in pulses])
    done = own.residuals(model, chi) - residual
    amplitudes, left = _ridge(done, residual)
    table = pd.DataFrame(pulses).assign(kind=effect.name, trial=case.name, amplitude=amplitudes * SIZES[effect])
    return left, _by_place(table)


def _pulses(effect: type[Effect], times: np.ndarray, length: float) -> list[dict[str, float]]:
    """Parameters of each pulse, by own names: along x and along y, at each time and place."""
    every = max(EVERY, np.ptp(times) / MOST)
    at = np.arange(times[0], times[-1] + every / 2, every)
    common = [{"at_t": float(t), "over_t": every / 2} for t in at]
    if effect is Push:
        common = [c | {"at_s": place * length, "over_s": length / 8} for c in common for place in PLACES]
    axes = ({"along_x": SIZES[effect], "along_y": 0.0}, {"along_x": 0.0, "along_y": SIZES[effect]})
    return [c | axis for c in common for axis in axes]


def _chi(model: Model, fit: Fit, effect: type[Effect], pulse: Mapping[str, float]) -> np.ndarray:
    """(P,) exponents of a model with a pulse, all else as fitted."""
    known = fit.theory.named(fit.chi)
    own = {effect.qualified(p): pulse[p.name] for p in effect.parameters}
    return np.array([known.get(p.name, float(p.chi(np.asarray(own.get(p.name, p.start))))) for p in model.parameters])


def _ridge(done: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes (C,) of directions (C, n) that take away most of the residual (n,), and what is left. What was not
    seen, as where frames are missing, has none."""
    size = np.sum(done**2, axis=1)
    seen = size > UNSEEN * size.max()
    some = done[seen]
    level = FIRMNESS * float(np.median(size[seen]))
    amplitudes = np.zeros(len(done))
    amplitudes[seen] = np.linalg.solve(some @ some.T + level * np.eye(len(some)), -some @ residual)
    return amplitudes, residual + amplitudes @ done


def _by_place(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of table MISSING: both directions of a pulse in one."""
    place = table["at_s"] if "at_s" in table else pd.Series(np.nan, index=table.index)
    rows = table.assign(s=place.fillna(-1.0), t=table["at_t"], axis=np.where(table["along_x"] > 0, "x", "y"))
    wide = rows.pivot_table(index=["kind", "trial", "t", "s"], columns="axis", values="amplitude").reset_index()
    return wide.assign(s=wide["s"].where(wide["s"] >= 0))


def unexplained(
    hypotheses: Hypotheses, fit: Fit, left: float, found: Missing | None, differs: Differing | None
) -> dict[str, object]:
    """What diagnosis.json says of what is left. left: share of the systematic misfit. differs: from trial to trial."""
    if found is None:
        return {"fraction": left, "where": "", "sentence": ""}
    each = enumerate(parts(hypotheses.evidence, fit.residual))
    size = np.array([systematic(hypotheses.evidence.only([k]), part) for k, part in each])
    case = hypotheses.evidence.cases[int(np.argmax(size))]
    share = float(size.max() / max(size.sum(), 1e-12))
    rows = found.table[found.table["trial"] == case.name]
    strength = np.hypot(rows["x"].fillna(0), rows["y"].fillna(0)).to_numpy()
    top = rows.iloc[int(np.argmax(strength))]
    place = "" if np.isnan(top["s"]) else f" at {top['s']:.2f} m along the string"
    where = f"most in trial {case.name} ({100 * share:.0f} % of it), strongest at {top['t']:.2f} s{place}"
    shares = ", ".join(f"{kind} {100 * part:.0f} %" for kind, part in found.explained.items())
    said = f"{_kind(found)}; {where}. Explained as {shares}."
    return {"fraction": left, "where": where, "sentence": f"{differs.sentence} {said}" if differs else said}


def _kind(found: Missing) -> str:
    """What is missing, in words."""
    regular = _regularity(found.table)
    return f"What is left looks like a {found.kind}, {regular}"


def _regularity(table: pd.DataFrame) -> str:
    """Whether it is steady, or changes its direction, or comes once."""
    pushes = table[["x", "y"]].fillna(0).to_numpy()
    size = np.hypot(*pushes.T)
    steady = np.hypot(*pushes.mean(axis=0)) / max(size.mean(), 1e-12)
    peak = np.sort(size**2)[::-1].cumsum() / max(float((size**2).sum()), 1e-12)
    if np.searchsorted(peak, 0.8) < 0.1 * len(size):
        return "short and in few places"
    return "mostly in one direction" if steady > STEADY else "in changing directions"
