"""What trials can tell, before causes are sought in them: from which size on each effect would be found, and which
effects would be taken for one another.

Beside the base model, fitted to the trials, each effect is simulated from little to the end of its range. What it moves
that the string's parameters cannot imitate, to first order, would have to be evident as a diagnosis asks it: by a Bayes
factor above 1/alpha, whichever trial is left out, where a smooth discrepancy of unknown size may explain it as well
(`stages.inference.discrepancy`). That is the mean for data with the noise that these have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.linear import Linear
from stringcast.stages.diagnose.prepared import Prepared
from stringcast.stages.diagnose.single_effects import Criteria
from stringcast.stages.inference.discrepancy import Discrepancy, marginal
from stringcast.stages.inference.evidence import Fit, size_density
from stringcast.stages.inference.solver import LOST
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.effect import Effect, components, position_dependent
from stringcast.stages.model.parameter import Parameter

SHARES = np.geomspace(1e-5, 1.0, 18)  # of the way from absent to the end of a range: each twice the last
LIKE = 0.5  # cosine between what two effects do, below which they are not taken for one another
DRAWS = 3  # of noise, each with its opposite
NOTHING = 1e-9  # [m] at the tip, or of noises: it does nothing


@dataclass(frozen=True)
class Foreseen:
    """What trials would say of one parameter that is an effect's size.

    absent: its value where the effect does nothing. found: the nearest value at which it would be found, and tip: how
    far that moves the string's tip, root mean square over all trials [m]; both NaN where no value of its range would
    be. most: how far the end of its range moves the tip [m]. imitated: share of what it does, in noises squared, that
    the string's parameters can imitate, and alike: names of effects for which it may be taken, both at the size found.
    """

    effect: type[Effect]
    parameter: Parameter
    absent: float
    found: float
    tip: float
    most: float
    imitated: float
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Acting:
    """A parameter of an effect at some SHARES of its range. chi: its exponents (C,). tip: how far they move it [m],
    (C,). left: what the string's parameters leave of that, over sigma, of each trial (C, 2 n). white: the same, white,
    (C, N). imitated: share of it that they do not leave, (C,)."""

    effect: type[Effect]
    parameter: Parameter
    absent: float
    chi: np.ndarray
    tip: np.ndarray
    left: list[np.ndarray]
    white: np.ndarray
    imitated: np.ndarray

    def at(self, tip: float) -> int:
        """The number at which it moves the tip about that far [m]."""
        return int(np.argmin(np.abs(np.log(np.maximum(self.tip, NOTHING) / tip))))


def foreseen(
    prepared: Prepared,
    effects: Sequence[type[Effect]],
    criteria: Criteria,
    seed: int,
    progress: Progress = lambda share: None,
) -> list[Foreseen]:
    """What prepared trials would say of each effect that acts wherever the string is, by name; none of those that
    cannot be simulated. criteria: what decides in a diagnosis. seed: of noise."""
    trials = _Trials(prepared.data, prepared.base, np.random.default_rng(seed))
    anywhere = [effect for effect in effects if not position_dependent(effect)]
    acting: list[_Acting] = []
    for number, effect in enumerate(anywhere, 1):
        acting += trials.acting(effect)
        progress(number / len(anywhere))
    return [_told(trials, each, acting, criteria) for each in acting]


def _told(trials: _Trials, own: _Acting, acting: Sequence[_Acting], criteria: Criteria) -> Foreseen:
    """What is said of one of them."""
    siblings = [each for each in acting if each.effect is own.effect and each is not own]
    found, tip = _crossing(own, trials.evidence(own, siblings) - criteria.enough, criteria.least_size)
    said = (
        own.effect,
        own.parameter,
        float(own.parameter.value(np.asarray(own.absent))),
        found,
        tip,
        float(own.tip[-1]),
    )
    if np.isnan(found):
        return Foreseen(*said, float(own.imitated[-1]), ())
    others = {each.effect: [o for o in acting if o.effect is each.effect] for each in acting}
    rivals = [e.name for e, o in others.items() if e is not own.effect and trials.taken_for(own, tip, o, criteria)]
    return Foreseen(*said, float(own.imitated[own.at(tip)]), tuple(sorted(rivals)))


def _crossing(own: _Acting, evident: np.ndarray, least: float) -> tuple[float, float]:
    """The value from which on it is evident (C,) and moves the tip by the least that counts [m], and how far it moves
    the tip there; NaN where it never does."""
    place = np.arange(len(evident), dtype=float)
    if evident[-1] < 0 or own.tip[-1] < least:
        return np.nan, np.nan
    last = int(np.flatnonzero(np.append(True, (evident < 0) | (own.tip < least)))[-1]) - 1  # number that is not enough
    if last < 0:
        return float(own.parameter.value(own.chi[0])), float(own.tip[0])
    rises = [
        (-evident[last], evident[last + 1] - evident[last]),
        (least - own.tip[last], own.tip[last + 1] - own.tip[last]),
    ]
    at = last + max(np.clip(way / rise, 0.0, 1.0) for way, rise in rises if rise > 0)
    return float(own.parameter.value(np.interp(at, place, own.chi))), float(np.interp(at, place, own.tip))


class _Trials:
    """Trials at the base model's best, with noise and nothing lacking."""

    def __init__(self, data: Data, base: Fit, rng: np.random.Generator) -> None:
        self.data, self.base = data, replace(base, sizes=np.zeros(len(data.trials), dtype=int))
        self.linear = Linear(data, self.base)
        self.noise = [_noise(trial.discrepancy, rng) for trial in data.trials]

    def acting(self, effect: type[Effect]) -> Iterator[_Acting]:
        """Each parameter that is an effect's size, at SHARES of its range; up to where it cannot be simulated."""
        hypothesis = self.base.hypothesis.joined(effect)
        start = hypothesis.carried(self.base.named)
        for place, parameter in zip(hypothesis.places(effect, components(effect)), components(effect), strict=True):
            chi = np.repeat(start[None], len(SHARES), axis=0)
            chi[:, place] += SHARES * ((0.0 if start[place] > 0.5 else 1.0) - start[place])
            responses = self.linear.responses(hypothesis, chi)
            good = np.logical_and.accumulate((responses[0] != LOST).all(axis=1))
            moved = [each[good] for each in responses]
            tip = self.data.tip_sizes(moved)
            if len(tip) and tip[-1] > NOTHING:
                yield _Acting(effect, parameter, start[place], chi[good, place], tip, *self._beyond(moved))

    def _beyond(self, moved: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """What the string's parameters leave of displacements, the same white, and the share that they do not."""
        step, left = self.linear.steps(moved)
        parts = [each + step @ slope for each, slope in zip(moved, self.base.slopes, strict=True)]
        whole = np.maximum(np.sum((left - step @ self.linear.slopes) ** 2, axis=1), NOTHING**2)
        return parts, left, 1.0 - np.minimum(np.sum(left**2, axis=1) / whole, 1.0)

    def evidence(self, own: _Acting, siblings: Sequence[_Acting]) -> np.ndarray:
        """Mean gain of the log evidence by an effect that is there, without the trial that says most, (C,). siblings:
        the effect's other components, which are not, and cost what they could explain of noise."""
        gains = self._gains(own.left)
        return np.asarray(gains.sum(axis=0) - gains.max(axis=0) + _cost(own) + sum(_cost(each)[0] for each in siblings))

    def taken_for(self, own: _Acting, tip: float, theirs: Sequence[_Acting], criteria: Criteria) -> bool:
        """Whether another effect, all of its components at the size that suits, is as likely as one that moves the tip
        that far [m]: outside a credible set it has no more than what that leaves."""
        here, there = own.at(tip), [each.at(tip) for each in theirs]
        others = np.array([each.white[at] for each, at in zip(theirs, there, strict=True)])
        size = np.linalg.lstsq(others.T, own.white[here], rcond=None)[0]
        if np.linalg.norm(size @ others) < LIKE * np.linalg.norm(own.white[here]):
            return False
        pairs = list(zip(size, theirs, there, strict=True))
        explained = [sum(s * each.left[k][[at]] for s, each, at in pairs) for k in range(len(own.left))]
        apart = [part[[here]] - other for part, other in zip(own.left, explained, strict=True)]
        return bool(self._gains(apart).sum() < np.log(criteria.coverage / (1 - criteria.coverage)))

    def _gains(self, left: Sequence[np.ndarray]) -> np.ndarray:
        """Mean log-likelihood that each trial loses with displacements (C, 2 n) over sigma that nobody explains,
        (K, C)."""
        found = []
        for trial, noise, part in zip(self.data.trials, self.noise, left, strict=True):
            told = trial.discrepancy
            seen = told.coefficients(part)[:, None] + noise
            likely = marginal(told.log_likelihoods(seen.reshape(-1, seen.shape[-1]))).reshape(seen.shape[:2])
            found.append(marginal(told.log_likelihoods(noise)).mean() - likely.mean(axis=1))
        return np.array(found)


def _cost(own: _Acting) -> np.ndarray:
    """Log evidence that an effect of these sizes has before the data speak of it, (C,); as of
    `stages.inference.evidence`."""
    rise = np.maximum(np.linalg.norm(own.white, axis=1), NOTHING) / own.tip  # noises by one metre at the tip
    two_sided = own.parameter.low < own.parameter.start < own.parameter.high
    prior = np.maximum(size_density(own.tip, two_sided), np.finfo(float).tiny)
    return np.asarray(np.log(prior * np.sqrt(2 * np.pi) / rise))


def _noise(told: Discrepancy, rng: np.random.Generator) -> np.ndarray:
    """Coefficients (2 DRAWS, 2 M) of a trial's noise and beginning, each draw with its opposite."""
    size, modes = told.nuisance.shape
    drawn = rng.standard_normal((DRAWS, size)) + rng.standard_normal((DRAWS, modes)) @ told.nuisance.T
    return np.concatenate([drawn, -drawn])
