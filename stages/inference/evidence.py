"""Model hypotheses fitted to trials, and the evidence for each (Laplace's approximation: MacKay 2003, chapter 27).

    ln p(y | h) = sum_k ln p(y_k | theta, h) + ln p(theta | h) + P/2 ln 2 pi - 1/2 ln |H|

y_k are the coefficients of trial k, with the size of its discrepancy integrated out (`discrepancy`); H the curvature at
the best theta. Before the data speak every exponent in its range is equally likely, but for the size of a cause: of
that it is how far it moves the tip [m], half-normal of several widths. So a cause of whatever unit pays the same for
being there, and one that moves nothing is no worse than none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy import likeliest, marginal
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import PRIOR, Likelihood
from stringcast.stages.inference.solver import LOST
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import Effect, components

WIDTHS = np.array([1e-3, 3e-3, 1e-2, 3e-2])  # [m] by which a cause may well move the tip, each as likely
ROUNDS = 6  # at most, in turns with the sizes of discrepancies: it mostly takes three
FEW = 4  # iterations of several starts, before the best alone goes on
DRAWS = 400  # of what may be lacking: a probability is told to 0.025
ABSENT = 1e-9  # of a range: nearer than that is not there


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its best. chi: (P,). residuals: over sigma, of each trial (2 n,); slopes: of them with chi,
    (P, 2 n). sizes: (K,) likeliest number of SIZES of each discrepancy. by_trial: (K,) log-likelihood of each trial,
    whatever that is. evidence: ln p(y | h)."""

    hypothesis: Hypothesis
    chi: np.ndarray
    residuals: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    sizes: np.ndarray
    by_trial: np.ndarray
    evidence: float

    @property
    def named(self) -> dict[str, float]:
        """Exponents by name."""
        return {p.name: float(chi) for p, chi in zip(self.hypothesis.parameters, self.chi, strict=True)}

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return {p.name: float(p.value(chi)) for p, chi in zip(self.hypothesis.parameters, self.chi, strict=True)}

    def of(self, cause: type[Effect]) -> dict[str, float]:
        """A cause's parameters by their own names."""
        return {p.name: self.values[cause.qualified(p)] for p in cause.parameters}

    @property
    def lost(self) -> bool:
        """Whether a trial could not be simulated."""
        return any((each == LOST).any() for each in self.residuals)


def fitted(
    data: Data,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.ENOUGH,
) -> Fit:
    """A hypothesis at its best from these starts (C, P), in turns with the sizes of the discrepancies, from (K,) on.

    enough: a step that gains less of the log-likelihood is the last of its turn.
    """
    return evaluated(data, hypothesis, at_best(data, hypothesis, starts, sizes, enough))


def at_best(
    data: Data,
    hypothesis: Hypothesis,
    starts: np.ndarray,
    sizes: np.ndarray,
    enough: float = solver.ENOUGH,
) -> np.ndarray:
    """Exponents (P,) of `fitted`."""
    data = data.of(hypothesis)
    first = solver.fitted(_problem(data, hypothesis, sizes), starts, FEW, enough)
    told = data.log_likelihoods(data.residuals(hypothesis.model, first.chi))
    best = int(np.argmax(marginal(told).sum(axis=0)))
    chi, sizes = first.chi[best], likeliest(told[:, best])
    for _ in range(ROUNDS - 1):
        chi = solver.fitted(_problem(data, hypothesis, sizes), chi[None], enough=enough).chi[0]
        new = likeliest(data.log_likelihoods(data.residuals(hypothesis.model, chi[None]))[:, 0])
        if (new == sizes).all():
            break
        sizes = new
    return np.asarray(chi)


def evaluated(data: Data, hypothesis: Hypothesis, chi: np.ndarray) -> Fit:
    """What a hypothesis says of the data where it is, exponents (P,)."""
    data = data.of(hypothesis)
    raw = [each[0] for each in data.residuals(hypothesis.model, chi[None])]
    told = data.log_likelihoods([each[None] for each in raw])[:, 0]
    sizes, by_trial = likeliest(told), marginal(told)
    places = [place for cause in hypothesis.causes for place in hypothesis.places(cause, components(cause))]
    absent = np.where(np.eye(len(chi), dtype=bool)[places], hypothesis.carried({}), chi)  # one size each
    slopes, without = _slopes(data, hypothesis, chi, raw, sizes, absent)
    white = data.white(slopes, sizes)
    moved = [r - w for r, w in zip(raw, without, strict=True)]
    prior, bounded = _prior(data, hypothesis, chi, places, moved, slopes)
    normal = white @ white.T + np.diag(bounded)
    occam = 0.5 * (len(chi) * np.log(2 * np.pi) - np.linalg.slogdet(normal)[1])
    evidence = float(by_trial.sum() + prior + occam)
    return Fit(hypothesis, chi, tuple(raw), tuple(slopes), sizes, by_trial, evidence)


def lacked(data: Data, fit: Fit) -> list[np.ndarray]:
    """Compute the most likely discrepancy of each trial, over sigma, (2 n,)."""
    means = []
    for trial, residual, size in zip(data.of(fit.hypothesis).trials, fit.residuals, fit.sizes, strict=True):
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        means.append(trial.discrepancy.mean(coefficients, int(size)))
    return means


def tip_draws(data: Data, fit: Fit, rng: np.random.Generator) -> np.ndarray:
    """Draw discrepancies as likely as the data leave them, and compute their root mean squares at each tip [m], (K,
    DRAWS)."""
    data = data.of(fit.hypothesis)
    draws = []
    for trial, residual, size in zip(data.trials, fit.residuals, fit.sizes, strict=True):
        coefficients = trial.discrepancy.coefficients(residual[None])[0]
        draws.append(trial.discrepancy.draws(coefficients, int(size), DRAWS, rng))
    return data.tip_rms(draws)


def _problem(data: Data, hypothesis: Hypothesis, sizes: np.ndarray) -> Likelihood:
    """The trials as a hypothesis explains them. sizes: (K,) of the discrepancies."""
    return Likelihood(data, hypothesis.model, sizes, uniform=hypothesis.base_places)


def _slopes(
    data: Data, hypothesis: Hypothesis, chi: np.ndarray, raw: Sequence[np.ndarray], sizes: np.ndarray, more: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Slopes (P, 2 n) of each trial's residuals (2 n,): forward differences as wide as the solver's. Beside them
    residuals at more exponents (A, P), (A, 2 n): lanes of a batch cost next to nothing."""
    width = np.full(len(chi), solver.FIRST)
    for _ in range(2):  # the first differences say how wide the second should be
        offset = np.where(chi > 0.5, -width, width)
        found = data.residuals(hypothesis.model, np.concatenate([chi + np.diag(offset), more]))
        beside, others = zip(*((each[: len(chi)], each[len(chi) :]) for each in found), strict=True)
        pairs = zip(beside, raw, strict=True)
        slopes = [np.where((b == LOST) | (r == LOST), 0.0, b - r) / offset[:, None] for b, r in pairs]
        width = solver.suited(data.white(slopes, sizes)[None], np.ones(1))[0]
    return slopes, list(others)


def _prior(
    data: Data,
    hypothesis: Hypothesis,
    chi: np.ndarray,
    places: Sequence[int],
    moved: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
) -> tuple[float, np.ndarray]:
    """Log density of the causes' sizes at exponents (P,), and the curvature (P,) that stands for the ranges of all
    other parameters. places: of the causes' sizes, (A,). moved: what each of them does in each trial, (A, 2 n)."""
    total, bounded = 0.0, np.full(len(chi), PRIOR)
    bounded[places] = ABSENT
    far, by_slope = np.abs(chi - hypothesis.carried({}))[places], data.tip_sizes([slope[places] for slope in slopes])
    for place, off, moves, rise in zip(places, far, data.tip_sizes(moved), by_slope, strict=True):
        size = hypothesis.parameters[place]
        there, per_chi = (moves, moves / off) if off > ABSENT else (0.0, rise)
        density = size_density(np.asarray(there), size.low < size.start < size.high) * per_chi
        total += float(np.log(max(density, np.finfo(float).tiny)))
    return total, bounded


def size_density(moves: np.ndarray, two_sided: bool) -> np.ndarray:
    """Density, before the data speak, of how far a cause moves the tip [m], (...) [1/m]; to either side it is half."""
    each = np.sqrt(2 / np.pi) / WIDTHS * np.exp(-0.5 * (moves[..., None] / WIDTHS) ** 2)
    return np.asarray(each.mean(axis=-1) * (0.5 if two_sided else 1.0))
