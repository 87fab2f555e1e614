"""Model hypotheses fitted to trials, and the evidence for each (Laplace's approximation: MacKay 2003, chapter 27).

    ln p(y | h) = sum_k ln p(y_k | theta, h) + ln p(theta | h) + P/2 ln 2 pi - 1/2 ln |H|

y_k are the coefficients of trial k, with the size of its discrepancy integrated out (`discrepancy`); H the curvature at
the best theta. Before the data speak every exponent in its range is equally likely, but for the size of a cause: of
that it is how far it moves the tip [m], half-normal of several widths. So a cause of whatever unit pays the same for
being there, and one that moves nothing is no worse than none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import away
from stringcast.stages.inference.covariance import PRIOR
from stringcast.stages.inference.discrepancy import Discrepancy, likeliest, marginal
from stringcast.stages.inference.forward import Case
from stringcast.stages.inference.initial_modes import as_first_told, change, modes, suited
from stringcast.stages.inference.solver import LOST
from stringcast.stages.model.effect import Effect, components
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter, values_of

WIDTHS = np.array([1e-3, 3e-3, 1e-2, 3e-2])  # [m] by which a cause may well move the tip, each as likely
ROUNDS = 6  # at most, in turns with the sizes of discrepancies: it mostly takes three
FEW = 4  # iterations of several starts, before the best alone goes on
DRAWS = 400  # of what may be lacking: a probability is told to 0.025
ABSENT = 1e-9  # of a range: nearer than that is not there
NEAR = 0.05  # of a range: farther off, slopes do not tell what a finer mesh changes
LATELY = 64  # candidates whose residuals are kept: those of some iterations


@dataclass(frozen=True)
class Hypothesis:
    """A base model with causes beside its own effects."""

    base: Model
    causes: tuple[type[Effect], ...] = ()

    @cached_property
    def model(self) -> Model:
        """With the causes at work."""
        return self.base.with_effects(*self.causes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """(P,) of the model, all of which are fitted."""
        return self.model.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Of the causes."""
        return tuple(cause.name for cause in self.causes)

    def joined(self, cause: type[Effect]) -> Hypothesis:
        """With one more cause."""
        return replace(self, causes=(*self.causes, cause))

    def without(self, cause: type[Effect]) -> Hypothesis:
        """With one less."""
        return replace(self, causes=tuple(other for other in self.causes if other is not cause))

    def places(self, cause: type[Effect], parameters: Sequence[Parameter]) -> list[int]:
        """Of some parameters of a cause among all."""
        return [self.model.names.index(cause.qualified(p)) for p in parameters]

    @cached_property
    def base_places(self) -> list[int]:
        """Of the base model's parameters among all."""
        return [self.model.names.index(name) for name in self.base.names]

    def carried(self, known: Mapping[str, float]) -> np.ndarray:
        """(P,) exponents known by name; those of others at their start, where a cause is absent."""
        return np.array([known.get(p.name, float(p.chi(np.asarray(p.start)))) for p in self.parameters])


@dataclass(frozen=True)
class Finer:
    """What a finer mesh changes in how parameters act, about exponents (P,) at which numerical error was taken off
    (manifold mapping: Echeverria and Hemker 2005, Comput. Methods Appl. Math. 5, 107). names: (P,) of the parameters.
    slopes: of each trial's residuals over sigma, (P, 2 n)."""

    names: tuple[str, ...]
    chi: np.ndarray
    slopes: tuple[np.ndarray, ...]

    def about(self, known: Mapping[str, float]) -> Finer:
        """The same where numerical error is taken off at other exponents, known by name."""
        return replace(self, chi=np.array([known.get(n, own) for n, own in zip(self.names, self.chi, strict=True)]))

    def beside(self, names: Sequence[str], chi: np.ndarray) -> list[np.ndarray]:
        """What it changes at exponents (C, P') of these names, (C, 2 n) of each trial: of those it knows, and farther
        off as much as where slopes end."""
        pairs = [(own, names.index(name)) for own, name in enumerate(self.names) if name in names]
        own, there = (list(each) for each in zip(*pairs, strict=True))
        away = np.clip(chi[:, there] - self.chi[own], -NEAR, NEAR)
        return [away @ slope[own] for slope in self.slopes]


@dataclass(frozen=True)
class Data:
    """Trials that hypotheses are to explain together, and what each may lack.

    varying: of causes, by name, that differ from trial to trial: how they move each trial, over sigma, by what is as
    likely as one deviation, (2 n, m). finer: which residuals have.
    """

    trials: tuple[Case, ...]
    discrepancies: tuple[Discrepancy, ...]
    varying: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)
    finer: Finer | None = None

    def of(self, hypothesis: Hypothesis) -> Data:
        """As a hypothesis has them, some of whose causes may differ from trial to trial."""
        names = tuple(name for name in hypothesis.names if name in self.varying)
        if not names:
            return self
        if names not in self._of:
            columns = [np.hstack(each) for each in zip(*(self.varying[name] for name in names), strict=True)]
            told = tuple(d.joined(each) for d, each in zip(self.discrepancies, columns, strict=True))
            self._of[names] = Data(self.trials, told, finer=self.finer)
        return self._of[names]

    def differs(self, name: str) -> float:
        """By how much the tip is elsewhere from trial to trial because a cause differs [m]; 0 where it does not."""
        columns = self.varying.get(name, ())
        return float(self.tip_sizes([each.T for each in columns])[0]) if columns else 0.0

    @cached_property
    def _of(self) -> dict[tuple[str, ...], Data]:
        return {}

    def residuals(self, model: Model, chi: np.ndarray) -> list[np.ndarray]:
        """Simulated less measured over sigma of each trial, (C, 2 n), for exponents (C, P); LOST where a run was
        rejected. One candidate alone is not simulated again if it was lately: a fit ends where another begins."""
        keys = [(id(model), one.tobytes()) for one in chi]
        if len(chi) == 1 and keys[0] in self._lately:
            return list(self._lately[keys[0]][1])
        found = [np.nan_to_num(each, nan=LOST) for each in away(model, self.trials, values_of(model.parameters, chi))]
        if self.finer is not None:
            pairs = zip(found, self.finer.beside(model.names, chi), strict=True)
            found = [np.where(each == LOST, LOST, each + more) for each, more in pairs]
        for key, *rows in zip(keys[-LATELY:], *(each[-LATELY:] for each in found), strict=True):
            self._lately[key] = model, [row[None].copy() for row in rows]
        while len(self._lately) > LATELY:
            self._lately.pop(next(iter(self._lately)))
        return found

    @cached_property
    def _lately(self) -> dict[tuple[int, bytes], tuple[Model, list[np.ndarray]]]:
        """By the model, which is kept so that no other has its id, and the exponents."""
        return {}

    def coefficients(self, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
        """(C, 2 M) of each trial's residuals (C, 2 n)."""
        return [d.coefficients(each) for d, each in zip(self.discrepancies, residuals, strict=True)]

    def log_likelihoods(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """Of residuals (C, 2 n) of each trial, at all sizes of its discrepancy, (K, C, S)."""
        told = zip(self.discrepancies, self.coefficients(residuals), strict=True)
        return np.stack([d.log_likelihoods(each) for d, each in told])

    def white(self, residuals: Sequence[np.ndarray], sizes: np.ndarray) -> np.ndarray:
        """Coefficients of each trial's residuals (C, 2 n), side by side, (C, N): white if its discrepancy has its
        number of SIZES. sizes: (K,)."""
        told = zip(self.discrepancies, self.coefficients(residuals), sizes, strict=True)
        return np.concatenate([d.white(each, size) for d, each, size in told], axis=1)

    def begun(self, residuals: Sequence[np.ndarray], sizes: np.ndarray) -> list[np.ndarray]:
        """Residuals (2 n,) of each trial without what another beginning explains. sizes: (K,) of SIZES."""
        told = zip(self.discrepancies, self.coefficients([each[None] for each in residuals]), sizes, strict=True)
        explained = [d.beginning(each[0], int(size)) for d, each, size in told]
        return [each - part for each, part in zip(residuals, explained, strict=True)]

    def about(self, fit: Fit) -> Data:
        """Data whose trials begin in the states that are likeliest with a fit, with modes as they are there."""
        if all(trial.initial is None for trial in self.trials):
            return self
        begun, known = self.begun_anew(fit), zip(self.trials, self.discrepancies, strict=True)
        plain = [as_first_told(trial, -d.modes).points for trial, d in known]
        columns = modes(begun, values_of(fit.hypothesis.parameters, fit.chi[None])[0])
        pairs = zip(begun, plain, columns, strict=True)
        trials = tuple(as_first_told(replace(trial, points=points), own) for trial, points, own in pairs)
        told = zip(self.trials, self.discrepancies, columns, strict=True)
        return replace(self, trials=trials, discrepancies=tuple(d.instead(own, len(change(t))) for t, d, own in told))

    def begun_anew(self, fit: Fit) -> tuple[Case, ...]:
        """The trials in the initial states that are likeliest with a fit, whatever it lacks."""
        if all(trial.initial is None for trial in self.trials):
            return self.trials
        hypothesis, data, found = fit.hypothesis, self.of(fit.hypothesis), []
        values = values_of(hypothesis.parameters, fit.chi[None])[0]
        sizes = likeliest(data.log_likelihoods(data.residuals(hypothesis.model, fit.chi[None]))[:, 0])
        for trial, told, size in zip(data.trials, data.discrepancies, sizes, strict=True):
            own = replace(trial, model=hypothesis.model)
            found.append(own if trial.initial is None else _likeliest_beginning(own, trial, told, int(size), values))
        return tuple(found)

    def only(self, chosen: Sequence[int]) -> Data:
        """Some of the trials."""
        varying = {name: tuple(columns[k] for k in chosen) for name, columns in self.varying.items()}
        finer = self.finer and replace(self.finer, slopes=tuple(self.finer.slopes[k] for k in chosen))
        return Data(tuple(self.trials[k] for k in chosen), tuple(self.discrepancies[k] for k in chosen), varying, finer)

    def tip_rms(self, displacements: Sequence[np.ndarray]) -> np.ndarray:
        """Root mean square over each trial of displacements (..., 2 n) over sigma, at the outermost place [m],
        (K, ...)."""
        found = []
        for trial, each in zip(self.trials, displacements, strict=True):
            there = each.reshape(*each.shape[:-1], len(trial.s), 2).compress(trial.tip, axis=-2)
            away = there * trial.sigma[trial.tip, None]
            found.append(np.sqrt(np.mean(np.sum(away**2, axis=-1), axis=-1)))
        return np.array(found)

    def tip_sizes(self, displacements: Sequence[np.ndarray]) -> np.ndarray:
        """Root mean square over all trials of displacements (C, 2 n) over sigma in each, as of `tip_rms` [m], (C,)."""
        return np.asarray(np.sqrt(np.mean(self.tip_rms(displacements) ** 2, axis=0)))


@dataclass(frozen=True)
class Problem:
    """A hypothesis as the solver's problem: trials, and that exponents of the base model may lie anywhere in [0, 1],
    which keeps those about the middle that the trials do not tell. sizes: (K,) of the discrepancies."""

    data: Data
    hypothesis: Hypothesis
    sizes: np.ndarray
    limit: float = np.inf

    @property
    def parameters(self) -> Sequence[Parameter]:
        """As of `solver.Problem`."""
        return self.hypothesis.parameters

    def residuals(self, chi: np.ndarray) -> np.ndarray:
        """As of `solver.Problem`."""
        raw = self.data.residuals(self.hypothesis.model, chi)
        lost = np.stack([(each == LOST).any(axis=1) for each in raw], axis=1)
        widths = [2 * len(d.variance) for d in self.data.discrepancies]
        white = np.where(np.repeat(lost, widths, axis=1), LOST, self.data.white(raw, self.sizes))
        return np.hstack([white, np.sqrt(PRIOR) * (chi[:, self.hypothesis.base_places] - 0.5)])


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
    first = solver.fitted(Problem(data, hypothesis, sizes), starts, FEW, enough)
    told = data.log_likelihoods(data.residuals(hypothesis.model, first.chi))
    best = int(np.argmax(marginal(told).sum(axis=0)))
    chi, sizes = first.chi[best], likeliest(told[:, best])
    for _ in range(ROUNDS - 1):
        chi = solver.fitted(Problem(data, hypothesis, sizes), chi[None], enough=enough).chi[0]
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


def _likeliest_beginning(own: Case, trial: Case, told: Discrepancy, size: int, values: np.ndarray) -> Case:
    """A trial, as its own model and as data have it, in the initial state that is likeliest with values (P,)."""
    count = len(change(trial))
    away = told.modes[:, :count] @ change(trial)  # which its points were displaced by
    rest = told.instead(told.modes[:, :0], count)
    return suited(own, own, values, lambda residual: rest.white(rest.coefficients(residual + away), size))


def lacked(data: Data, fit: Fit) -> list[np.ndarray]:
    """What a fit most likely lacks in each trial, over sigma, (2 n,)."""
    data = data.of(fit.hypothesis)
    told = zip(data.discrepancies, data.coefficients([each[None] for each in fit.residuals]), fit.sizes, strict=True)
    return [d.mean(each[0], int(size)) for d, each, size in told]


def tip_draws(data: Data, fit: Fit, rng: np.random.Generator) -> np.ndarray:
    """Root mean squares at the tip of each trial of what a fit may lack, as likely as the data leave it [m], (K,
    DRAWS)."""
    data = data.of(fit.hypothesis)
    told = zip(data.discrepancies, data.coefficients([each[None] for each in fit.residuals]), fit.sizes, strict=True)
    return data.tip_rms([d.draws(each[0], int(size), DRAWS, rng) for d, each, size in told])


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
