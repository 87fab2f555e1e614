"""Where a fit of one more cause may start: what each effect would explain of the residual, to first order.

Every effect is tried at a few sizes and places of its range. What the fitted parameters would do about it is counted in
(a Gauss-Newton step), and its size is taken where it explains most. Such scores say what is worth a fit, never what is
named: of 26 causes that proved right they were 0.02 to 1.1 times what a fit then gained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from stringcast.stages.diagnose.linear import Linear
from stringcast.stages.diagnose.places import APART, touching, varied_parameters
from stringcast.stages.inference.evidence import WIDTHS, Fit
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import CameraEffect, Effect, HandEffect, ModelChange, components, position_dependent
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.model import Model

LITTLE = 0.03  # of the way from absent to the end of the range, where it is looked how far an effect moves the tip
TRIED = WIDTHS[1:3]  # [m] at the tip that it is tried at
UNSEEN = 1e-7  # [m] at the tip: it does nothing
LARGEST = 2.0  # times a probe's size that it may be taken at, where it is still about linear
STARTS = 3  # of an effect's fit
VALUES = (np.arange(8) + 0.5) / 8  # of its range, at which a parameter of a cause is tried anew
CLOSER = (0.06, 0.03, 0.015)  # of a range, within which places are tried about the best ones
BEST = 4  # how many of these
UNMOVED = 1e-6  # standard deviations: what moves nothing explains nothing


@dataclass(frozen=True)
class Proposal:
    """One more cause. starts: (C, P) exponents, the most promising first. gain: of the log-likelihood there, to first
    order. direction: what it does for a unit of it that the fitted parameters cannot, white, (N,)."""

    hypothesis: Hypothesis
    starts: np.ndarray
    gain: float
    direction: np.ndarray

    @property
    def effect(self) -> type[Effect]:
        """The cause."""
        return self.hypothesis.causes[-1]

    def like(self, other: Proposal) -> float:
        """Cosine between what both do that the fitted parameters cannot: its square is the share of what one explains
        that the other could, to first order."""
        size = float(np.linalg.norm(self.direction) * np.linalg.norm(other.direction))
        return abs(float(self.direction @ other.direction)) / max(size, np.finfo(float).tiny)


def candidates(
    base: Model, library: Mapping[str, type[Effect]], trials: Sequence[Case], without: Sequence[str] = ()
) -> list[type[Effect]]:
    """Effects with parameters that are not in the base model and not excluded; of those on joints, only where there are
    joints; of those of a lens, only where it was not measured. without: names of those that cannot be at work."""
    grasp_only = any(isinstance(trial.motion, HandMotion) for trial in trials)
    return [
        e
        for e in library.values()
        if e not in base.effects
        and not e.excluded
        and e.name not in without
        and not issubclass(e, ModelChange)
        and not (base.camera.lens and issubclass(e, CameraEffect) and e.of_lens)
        and not (grasp_only and issubclass(e, HandEffect) and "grasp" not in e.laws())
    ]


def proposals(data: Data, parent: Fit, effects: Sequence[type[Effect]], seed: int) -> list[Proposal]:
    """Of each effect beside those at work, the most promising first; none of what can act nowhere in these trials."""
    linear = Linear(data, parent)
    found = [_placed(linear, e, seed) if position_dependent(e) else _anywhere(linear, e, seed) for e in effects]
    return sorted((each for each in found if each is not None), key=lambda each: -each.gain)


def elsewhere(data: Data, fit: Fit) -> np.ndarray:
    """Exponents (C, P) at which a parameter of a cause has another value, where that promises more: the most promising
    first. What says when or where leaves ridges and plains, on which a search by slopes ends."""
    linear, hypothesis = Linear(data, fit), fit.hypothesis
    places = [place for cause in hypothesis.causes for place in hypothesis.places(cause, cause.parameters)]
    found = [(np.zeros((0, len(fit.chi))), np.zeros(0)), *(linear.elsewhere(place, VALUES) for place in places)]
    chi, gain = (np.concatenate(each) for each in zip(*found, strict=True))
    return np.asarray(chi[np.argsort(-gain, kind="stable")][: int((gain > 0).sum())][:STARTS])


def _anywhere(linear: Linear, effect: type[Effect], seed: int) -> Proposal | None:
    """Of an effect that acts wherever the string is: at several sizes to both sides, at any time."""
    hypothesis = linear.parent.hypothesis.joined(effect)
    start = hypothesis.carried(linear.parent.named)
    size, chi = hypothesis.places(effect, components(effect)), _probes(linear, hypothesis, effect, seed)
    responses = linear.responses(hypothesis, chi)
    step, beyond = linear.steps(responses)
    square = np.sum(beyond**2, axis=1)
    first = effect.parameters[0]
    least = -LARGEST if first.low < first.start < first.high else 0.0
    times = np.clip(-(beyond @ linear.residual) / np.maximum(square, UNMOVED**2), least, LARGEST)
    gain = np.where(square > UNMOVED**2, linear.gains(responses, step, times), -np.inf)
    order = np.argsort(-gain, kind="stable")[:STARTS]
    if not np.isfinite(gain[order[0]]):
        return None
    starts, times = chi[order], times[order, None]
    starts[:, size] = start[size] + times * (starts[:, size] - start[size])
    # and the fitted parameters as they suit that
    fitted = [hypothesis.model.names.index(name) for name in linear.parent.named]
    starts[:, fitted] += times * step[order]
    return Proposal(hypothesis, np.clip(starts, 0.0, 1.0), float(gain[order[0]]), beyond[order[0]])


def _probes(linear: Linear, hypothesis: Hypothesis, effect: type[Effect], seed: int) -> np.ndarray:
    """Exponents (C, P) at which an effect is tried: such that it moves the tip as far as causes may well do."""
    start = hypothesis.carried(linear.parent.named)
    own, size = hypothesis.places(effect, varied_parameters(effect)), hypothesis.places(effect, components(effect))
    ends = np.array([[0.0], [1.0]])
    if len(own) > 1:
        ends = qmc.Sobol(len(own), seed=seed).random_base2(len(own) + 1)
        ends[:, 0] = np.round(ends[:, 0])
    rows = np.repeat(start[None], len(ends), axis=0)
    rows[:, own] = ends
    away = rows[:, size] - start[size]
    rows, away = rows[np.abs(away).max(axis=1) > 0], away[np.abs(away).max(axis=1) > 0]
    rows[:, size] = start[size] + LITTLE * away
    moves = linear.data.tip_sizes(linear.responses(hypothesis, rows))
    found = []
    for width in TRIED:
        share = np.clip(LITTLE * width / np.maximum(moves, UNSEEN), LITTLE**2, 1.0)
        rows[:, size] = start[size] + share[:, None] * away
        found.append(rows.copy())
    return np.unique(np.concatenate(found), axis=0)


def _placed(linear: Linear, effect: type[Effect], seed: int) -> Proposal | None:
    """Of an effect that depends on place: where it touches the string when that departs, ever closer about the places
    that explain most until shortly after. What happens later depends on everything; the parameters stay as they are."""
    hypothesis, rng = linear.parent.hypothesis.joined(effect), np.random.default_rng(seed)
    places = touching(linear.data, linear.parent, hypothesis, seed)
    chi, found = places.drawn(), []
    for reach in (*CLOSER, 0.0):
        if not len(chi):
            return None
        found.append((chi, linear.early_gains(linear.responses(hypothesis, chi), places.departs + APART)))
        starts, early = (np.concatenate(each) for each in zip(*found, strict=True))
        starts = starts[np.argsort(-early, kind="stable")]
        chi = places.about(starts[:BEST], reach, rng) if reach else chi
    responses = linear.responses(hypothesis, starts[:STARTS])
    same = np.zeros((len(responses[0]), len(linear.parent.chi)))
    gain = linear.gains(responses, same, np.ones(len(same))).max()
    if not np.isfinite(gain):
        return None
    return Proposal(hypothesis, starts[:STARTS], float(gain), linear.steps(responses)[1][0])
