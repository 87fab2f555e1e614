"""Screening: what each effect would explain of a residual, for almost nothing.

Every effect is tried at a few sizes and places of its range. What it does to the string is
taken as a direction, from which all that the fitted parameters can do themselves is
projected out; its score is the part of the residual along that direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.data.later import Later
from stringcast.stages.diagnose.evidence import LOST, Evidence
from stringcast.stages.diagnose.fit import PRIOR, Fit
from stringcast.stages.diagnose.single_effects.places import varied_parameters, way_of
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.effect import Effect, components, placed
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import values_of

stats = Later("scipy.stats")

SIZES = (0.2, 0.03)  # shares of the way from absent to the end of the range
PATH = 20000  # places on the string's way at which it is asked
DRAWS = 10  # places of which an effect that depends on place is asked, as a power of two
PLACES = 48  # of these that are simulated
TOUCHED = 0.1  # of the string's places on its way, at most
CLOSER = (0.06, 0.03, 0.015)  # of a range, within which places are tried about the best ones
BEST, ABOUT = 4, 6  # how many of these, and how many places about each
MOST = 2.0  # times a probe's size that it may be taken at
SHARES = (0.125, 0.25, 0.5, 1.0)  # of a probe's size at which it is taken where the best is not plausible
APART = 0.02  # of a range, between probes of an effect that are fitted


@dataclass(frozen=True)
class Probe:
    """One effect, tried. chi: (P,) of the theory with it. gain: of the log-likelihood, predicted to first order.
    direction: (N,) unit vector, what it does that the fitted parameters cannot."""

    theory: Theory
    effect: type[Effect]
    chi: np.ndarray
    gain: float
    direction: np.ndarray


def screened(evidence: Evidence, fit: Fit, effects: Sequence[type[Effect]], seed: int) -> dict[str, list[Probe]]:
    """Probes of each effect, most promising first. Those that share a model share a batch."""
    path = followed(evidence, fit)
    trials = [_Trial(joined(fit.theory, e), e, start_of(joined(fit.theory, e), fit)) for e in effects]
    tried = [(trial, sizes(trial, path, seed)) for trial in trials]
    own = projector(fit)
    # A set would have another order each time.
    models = dict.fromkeys(trial.theory.model.effects for trial in trials)
    found: dict[str, list[Probe]] = {}
    for model in models:
        some = [(trial, chi) for trial, chi in tried if trial.theory.model.effects == model and len(chi)]
        if some:
            seen = evidence.residuals(some[0][0].theory.model, np.concatenate([chi for _, chi in some]))
            parts = np.split(seen, np.cumsum([len(chi) for _, chi in some])[:-1])
            found |= {t.effect.name: _scored(t, chi, fit, own, r) for (t, chi), r in zip(some, parts, strict=True)}
    for trial in trials:
        if placed(trial.effect) and trial.effect.name in found:
            found[trial.effect.name] = _closer(evidence, trial, found[trial.effect.name], fit, own, seed)
    return found


def _closer(
    evidence: Evidence, trial: _Trial, probes: list[Probe], fit: Fit, own: np.ndarray, seed: int
) -> list[Probe]:
    """With more probes about the best, closer and closer: where something stands must be known rather well before a
    fit can find it."""
    rng = np.random.default_rng(seed)
    for reach in CLOSER:
        best = np.repeat(np.stack([probe.chi for probe in probes[:BEST]]), ABOUT, axis=0)
        chi = about(best, trial.own[1:], reach, rng)
        chi = chi[~trial.theory.on_hand(trial.effect, chi)]
        residual = evidence.residuals(trial.theory.model, chi)
        probes = sorted([*probes, *_scored(trial, chi, fit, own, residual)], key=lambda probe: -probe.gain)
    return probes


def about(chi: np.ndarray, where: Sequence[int], reach: float, rng: np.random.Generator) -> np.ndarray:
    """Exponents (C, P) within reach of those given in the places of some of them."""
    near = chi.copy()
    near[:, where] = np.clip(near[:, where] + rng.uniform(-reach, reach, (len(near), len(where))), 0, 1)
    return near


def varied(theory: Theory, effect: type[Effect]) -> list[int]:
    """Places of the parameters with which an effect is tried."""
    return theory.places(effect, varied_parameters(effect))


@dataclass(frozen=True)
class _Trial:
    """An effect to be tried. start: (P,) where it is absent and all else as fitted."""

    theory: Theory
    effect: type[Effect]
    start: np.ndarray

    @property
    def own(self) -> list[int]:
        """Places of the parameters that are tried."""
        return varied(self.theory, self.effect)

    @property
    def size(self) -> list[int]:
        """Places of the components of its size."""
        return self.theory.places(self.effect, components(self.effect))

    @property
    def room(self) -> tuple[float, float]:
        """Least and most times a probe's size that it may be taken at: not back beyond absent where a range ends."""
        first = self.effect.parameters[0]
        return (-MOST if first.low < first.start < first.high else 0.0), MOST


def spread(probes: Sequence[Probe], most: int) -> list[Probe]:
    """The most promising probes of an effect that differ in where, when or which way."""
    kept: list[Probe] = []
    for probe in probes:
        if all(np.abs(probe.chi - other.chi)[probe.theory.free].max() > APART for other in kept):
            kept.append(probe)
    return kept[:most]


def start_of(theory: Theory, fit: Fit) -> np.ndarray:
    """(P,) of a theory with more causes, which are absent."""
    return theory.carried(fit.theory.named(fit.chi))


def projector(fit: Fit) -> np.ndarray:
    """(N, free) orthonormal: what the fitted parameters can do, as far as the prior lets them."""
    u, size, _ = np.linalg.svd(fit.slopes, full_matrices=False)
    return u * np.sqrt(size**2 / (size**2 + PRIOR))


def without(own: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (C, N) less what lies along `own`."""
    return vectors - (vectors @ own) @ own.T


def _scored(trial: _Trial, chi: np.ndarray, fit: Fit, own: np.ndarray, residual: np.ndarray) -> list[Probe]:
    """Probes at chi (C, P), where residual is (C, N), most promising first."""
    beyond = without(own, residual - fit.residual)
    size = np.linalg.norm(beyond, axis=1)
    direction = beyond / np.maximum(size, 1e-9)[:, None]
    along = -direction @ fit.residual
    lowest, highest = trial.room
    step = np.clip(along, lowest * size, highest * size)
    seen = (size > 1e-6) & ~np.any(residual == LOST, axis=1)  # what was rejected says nothing
    gain = np.where(seen, along * step - step**2 / 2, 0.0)
    scaled = [_taken(trial, *probe) for probe in zip(chi, along, np.maximum(size, 1e-9), strict=True)]
    found = [Probe(trial.theory, trial.effect, *rest) for rest in zip(scaled, gain.tolist(), direction, strict=True)]
    return sorted(found, key=lambda probe: -probe.gain)


def _taken(trial: _Trial, chi: np.ndarray, along: float, size: float) -> np.ndarray:
    """The probe at the size that gains most, of those at which the effect is what it says."""
    best = float(np.clip(along / size, *trial.room))
    allowed = [share for share in (best, *SHARES) if trial.theory.plausible(_scaled(trial, chi, share))]
    return _scaled(trial, chi, max(allowed, key=lambda share: share * (along - share * size / 2), default=1.0))


def sizes(trial: _Trial, path: Mapping[str, np.ndarray], seed: int) -> np.ndarray:
    """Exponents (C, P) at which an effect is tried: at several sizes to both sides, anywhere and at any time."""
    own, start = trial.own, trial.start
    if placed(trial.effect):
        return touching(trial, path, seed)
    rows = []
    for size in SIZES:
        for end in _ends(len(own), seed):
            chi = start.copy()
            chi[own] = end
            rows.append(_scaled(trial, chi, size))
    return np.unique(np.clip(np.array(rows), 0, 1), axis=0)


def _ends(count: int, seed: int) -> np.ndarray:
    """Ends of the range of one parameter, or points spread over that of several, (C, count)."""
    if count == 1:
        return np.array([[0.0], [1.0]])
    some = stats.qmc.Sobol(count, seed=seed).random_base2(count + 1)
    some[:, 0] = np.round(some[:, 0])
    return some


def followed(evidence: Evidence, fit: Fit) -> dict[str, np.ndarray]:
    """The way of the fitted string through all trials, at a few places of it: arguments of laws, (M,) each."""
    values = values_of(fit.theory.model.parameters, fit.chi[None])
    parts = [_followed(evidence, fit.theory.model, case, values) for case in evidence.cases]
    every = max(sum(part["s"].size for part in parts) // PATH, 1)
    return {name: np.concatenate([part[name] for part in parts])[::every] for name in parts[0]}


def _followed(evidence: Evidence, model: Model, case: Case, values: np.ndarray) -> dict[str, np.ndarray]:
    coarse = model.divided(evidence.segments[0])
    points = coarse.true(case.motion, values, case.times, case.initial).points[0]
    return way_of(points, coarse.string.arc_lengths(), case.times)


def touching(trial: _Trial, path: Mapping[str, np.ndarray], seed: int) -> np.ndarray:
    """Exponents (C, P) at which an effect that depends on place acts on the string, but not on all of it nor the hand.

    Asked of the law itself along the string's way, without any simulation.
    """
    own = trial.own
    chi = np.repeat(trial.start[None], 2**DRAWS, axis=0)
    chi[:, own] = stats.qmc.Sobol(len(own), seed=seed).random_base2(DRAWS)
    chi[:, own[0]] = trial.start[own[0]] + SIZES[-1] * (1 - trial.start[own[0]])
    chi = chi[~trial.theory.on_hand(trial.effect, chi)]  # first: the hand's way is short
    share = np.mean(trial.theory.pushed(trial.effect, chi, path), axis=1)
    return chi[(share > 0) & (share < TOUCHED)][:PLACES]


def _scaled(trial: _Trial, chi: np.ndarray, factor: float) -> np.ndarray:
    """The probe at a multiple of its size."""
    size, result = trial.size, chi.copy()
    result[size] = np.clip(trial.start[size] + factor * (chi[size] - trial.start[size]), 0, 1)
    return result
