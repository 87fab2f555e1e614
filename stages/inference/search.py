"""The most likely parameters from nothing: many starts, and a horizon that widens.

A string that is swung forgets where it came from, so that a whole trial has many local minima. Its beginning is fitted
first, then more of it, while the better half of the starts goes on; those that have come to the same go on as one. The
mesh is refined on the way: all there is is fitted with the string as given, what comes before with coarser ones. What
another initial state could explain counts for little from the beginning, so that no start is lost by that. In the end
initial states, noise and parameters are found in turns, and outliers count less.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.common import Progress, mad_sigma
from stringcast.stages.inference.huber import LIMIT
from stringcast.stages.inference.initial_modes import SPAN, modes, settled
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import rungs
from stringcast.stages.inference.solver import ITERATIONS, fitted
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.model.parameter import values_of
from stringcast.stages.model.statics import GRAVITY

FIRST = np.pi / 2.405  # sqrt(L/g), fitted first: a quarter of the time in which a limp string swings to and fro
FEWEST = 10  # numbers measured for each parameter, at least, in the first horizon: as of any regression
GROWTH = 1.75  # of the horizon, from one to the next
NEARLY = 0.8  # of the longest trial: a horizon beyond that is all there is
FINALISTS = 8  # starts that go on to the end, if they have come to different places
SAME = 0.1  # of what is left, root mean square: runs that differ by less have come to the same place
CLOSE = 0.005  # of the log-likelihood: gains so small still add up, on the way along a valley to its end
ROUNDS = 10  # at most, in which initial states, noise and parameters are found; it mostly takes three
STAYS = 0.01  # of the trials' noise, in the geometric mean: a round that lowers it by less is the last
TINY = 1e-9  # of the noise: of exact data something is left, too


def screened(likelihood: Likelihood, chi: np.ndarray, count: int) -> np.ndarray:
    """Those candidates (C, P) that are best at the first horizon, best first, (count, P)."""
    ahead = horizons(likelihood)
    some = _meshes(likelihood, len(ahead))[0].until(ahead[0])
    misfit = np.mean(some.residuals(chi) ** 2, axis=1)
    return chi[np.argsort(misfit, kind="stable")[:count]]


def horizons(likelihood: Likelihood) -> list[float]:
    """Beginnings of trials that are fitted one after the other [s]; the last is all there is."""
    length = likelihood.model.string.length
    trials = likelihood.data.trials
    spans = [max(float(np.ptp(trial.times)), TINY) for trial in trials]
    rate = sum(2 * len(trial.s) / span for trial, span in zip(trials, spans, strict=True))
    found = [max(FIRST * np.sqrt(length / GRAVITY), FEWEST * len(likelihood.parameters) / rate)]
    while found[-1] * GROWTH < NEARLY * max(spans):
        found.append(found[-1] * GROWTH)
    return [*found, np.inf]


def searched(
    likelihood: Likelihood, starts: np.ndarray, most: int, progress: Progress = lambda share: None
) -> np.ndarray:
    """The best parameters (P,) from these starts (K, P), the best first. most: iterations of each before the last
    horizon."""
    chi, ahead = starts, horizons(likelihood)
    few = max(most // max(len(ahead) - 1, 1), 1)
    for number, (horizon, mesh) in enumerate(zip(ahead, _meshes(likelihood, len(ahead)), strict=True)):
        some = with_noise(mesh.until(horizon), chi[0])
        fits = fitted(some, chi, few if np.isfinite(horizon) else ITERATIONS)
        chi = fits.chi[_survivors(fits.residual, fits.loss)]
        progress((number + 1) / len(ahead))
    return chi[0]


def _meshes(likelihood: Likelihood, count: int) -> list[Likelihood]:
    """The likelihood with the mesh of each horizon, each half as fine as the next as far as the ladder goes."""
    ladder = rungs(likelihood)
    return [ladder[min(before, len(ladder) - 1)] for before in reversed(range(count))]


def _survivors(residual: np.ndarray, loss: np.ndarray) -> list[int]:
    """Runs that go on, best first: the better half of those that have come to different places. residual: (K, N).
    loss: (K,)."""
    kept: list[int] = []
    for run in np.argsort(loss, kind="stable")[: max(len(loss) // 2, FINALISTS)]:
        apart = [np.mean((residual[run] - residual[other]) ** 2) for other in kept]
        if all(each > SAME**2 * loss[run] for each in apart):
            kept.append(int(run))
    return kept


def refined(likelihood: Likelihood, chi: np.ndarray) -> tuple[Likelihood, np.ndarray]:
    """The likelihood with noise and initial states as they are at its maximum, and the parameters there, from near ones
    chi (P,)."""
    likelihood = with_initial_states(likelihood, chi, SPAN)
    for number in range(ROUNDS):
        there = fitted(likelihood, chi[None], enough=CLOSE).chi[0]
        anew = with_initial_states(likelihood, there)
        gain = np.mean(np.log(likelihood.scale)) - np.mean(np.log(anew.scale))
        if gain > 0 or number == 0:
            likelihood, chi = anew, there
        if gain < STAYS:
            break
    return likelihood, chi


def with_initial_states(likelihood: Likelihood, chi: np.ndarray, span: float = np.inf) -> Likelihood:
    """With the initial states that suit parameters (P,), and outliers that count less. span: of each trial's beginning
    that the states are found from [s]."""
    values = values_of(likelihood.parameters, chi)
    trials = [settled(trial, values, span) for trial in likelihood.data.trials]
    return replace(with_noise(likelihood.with_trials(trials), chi), limit=LIMIT)


def with_noise(likelihood: Likelihood, chi: np.ndarray) -> Likelihood:
    """With what parameters (P,) leave in each trial taken for its noise, and what other initial states could explain
    counting for little.

    What a model lacks is more in some trials than in others, and these must not pay for it: with one scale for all of
    four trials, of which a hardening bends two, a search ended 2.5 to 20 noises off, and ends 1 to 9 off with these.
    """
    plain = likelihood.with_trials([replace(t, error_model=UNIT_ERRORS) for t in likelihood.data.trials])
    residuals = plain.by_trial(chi[None])
    columns = modes(plain.data.trials, values_of(likelihood.parameters, chi)) or (None,) * len(residuals)
    trials = []
    for trial, residual, shapes in zip(plain.data.trials, residuals, columns, strict=True):
        errors = IndependentErrors(float(mad_sigma(residual)) + TINY, shapes)
        trials.append(replace(trial, error_model=errors))
    return plain.with_trials(trials)
