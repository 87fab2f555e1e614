"""From trials to data: the base model at its best, noise, outliers, numerical error, and what may be lacking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.dataset import FRAMES_NEEDED
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, tracked
from stringcast.stages.diagnose.varying import varying
from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import seen_together
from stringcast.stages.inference.discrepancy import Discrepancy, likeliest, smoothed, tracked_noise
from stringcast.stages.inference.evidence import Fit, at_best, evaluated, fitted, lacked
from stringcast.stages.inference.forward import Case, case
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import as_first_told, begun_anew, modes
from stringcast.stages.inference.likelihood import STILL, Likelihood
from stringcast.stages.inference.mesh import on_mesh
from stringcast.stages.inference.mesh_correction import Finer
from stringcast.stages.inference.noise import WHITE, told
from stringcast.stages.inference.search import refined, screened, searched, with_noise
from stringcast.stages.inference.solver import LOST
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.accuracy import extrapolated
from stringcast.stages.model.implicit import ImplicitLeapfrog
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import chi_of, values_of

SEGMENTS, STEP = 20, 1e-3  # [s]: 1 mm of error at the tip in a plain cast, which is corrected
GUESS = 1e-3  # [m] of noise before anything is known
STATED_WRONG = 1.3  # times the noise that the data's author states: then the data are believed
OUTLYING = 6.0  # noises from smooth motion: one point in 5e8 by chance
HIDDEN = 3  # times that outliers are looked for: one may hide another
STAY = 0.5  # of outliers: if fewer are so beside a better model, the poorer one made them
PASSES = 8  # of numerical error and fit at most: it mostly takes two
AT_END, WIDER, WIDENINGS = 0.02, 30.0, 3  # of a range; times as wide on that side; in turns
FEWEST = 2  # trials: what is found in one could not be checked on another
FIRST_ORDER = 0.25  # of what is extrapolated, in doubt: |4 / 2^p - 1| / 4 where halving the mesh is of order p
CLEARLY = 5.0  # of the log evidence: strong, by Jeffreys' scale
SETTLED = 1.0  # of the log evidence: to gain less is not worth a mention, by the same
MOST = 20  # iterations of the search before its last horizon
LEAST_GROWTH = 0.1  # of the largest: early frames are not exact either
RESTING = 0.2  # [s] that are kept of a string at rest


@dataclass(frozen=True)
class Prepared:
    """What a search for causes starts from.

    data: with noise and numerical error. base: the base model at its best. whole: the trials with their outliers. raw:
    without them, before numerical error was taken off. resting: points left out, at rest. doubt: of numerical error at
    the tip of each trial [m]. literal: the mesh is a part of the model, and has no error. chaotic: names of trials that
    no simulation tells to the tolerance; trusted: of those that one with causes tells.
    configured: the base model with the mesh as it is configured, at its best; None where that is the finer one.
    stated: the data's author states their noise.
    """

    data: Data
    base: Fit
    whole: tuple[Case, ...]
    raw: tuple[Case, ...]
    resting: int
    doubt: np.ndarray
    literal: bool = False
    chaotic: tuple[str, ...] = ()
    configured: Fit | None = None
    stated: bool = False
    trusted: tuple[str, ...] = ()

    def at(self, fit: Fit) -> Prepared:
        """With numerical error and what may be lacking as they are at a fit."""
        raw = _begun(self.raw, begun_anew(self.data, fit))
        data, doubt = self.of(raw, fit)
        return replace(self, raw=raw, data=replace(data, finer=self._finer_at(fit)), doubt=doubt)

    def _finer_at(self, fit: Fit) -> Finer | None:
        finer = None if self.literal else self.data.finer
        return finer and finer.about(fit.named)

    @property
    def counts(self) -> list[int]:
        """How many points of each trial causes are sought in."""
        return [len(trial.s) for trial in self.raw]

    @property
    def outliers(self) -> int:
        """How many points are left out for being far from smooth motion."""
        return sum(len(trial.s) for trial in self.whole) - sum(self.counts)

    def heard(self, fit: Fit) -> Prepared:
        """With noise as what a fit leaves tells it, and with outliers if most of them are none: what a poorer model
        lacks may have sounded like noise, and where the string whips it may have looked like outliers."""
        if self.outliers:
            whole = _begun(self.whole, begun_anew(self.data, fit))
            kept, left, _ = _cleared(whole, fit.hypothesis.model, fit.chi)
            anew = replace(self, whole=whole, raw=kept, data=replace(self.data, finer=None))
            if anew.outliers < STAY * self.outliers:
                return replace(anew, raw=_heard(kept, left, self.stated))
        return replace(self, raw=_heard(self.raw, fit.residuals, self.stated))

    def told_by(self, fit: Fit) -> Data:
        """Data without the numerical error of a fit as one finer mesh tells it; what may be lacking is as before, which
        tells at a tenth of the cost of `at` whether a fit is worth more."""
        if self.literal:
            return self.data
        pairs = _on_meshes(self.raw, fit.hypothesis, fit.chi, (1, 2))
        told = zip(self.data.trials, self.raw, pairs, strict=True)
        exact = (replace(t, points=r.points - np.nan_to_num(extrapolated(a, b) - a)) for t, r, (a, b) in told)
        trials = tuple(as_first_told(trial, trial.discrepancy.modes) for trial in exact)
        return replace(self.data, trials=trials, finer=self._finer_at(fit))

    def of(self, trials: Sequence[Case], fit: Fit) -> tuple[Data, np.ndarray]:
        """Data of any trials without the numerical error of a fit, and what is in doubt of that at each tip [m]."""
        own = [replace(trial, model=fit.hypothesis.model) for trial in trials]
        if self.literal:
            return lacking(own, fit.hypothesis, fit.chi), np.zeros(len(own))
        return corrected(own, fit.hypothesis, fit.chi)

    def others(self, observations: Sequence[Observation], fit: Fit) -> tuple[Data, np.ndarray]:
        """Data of further trials, with the noise of these and without a fit's numerical error, and what is in doubt of
        that at each tip [m]."""
        base, sigma = self.base, float(np.median(np.concatenate([trial.sigma for trial in self.raw])))
        model, noise = base.hypothesis.model, self.raw[0].noise
        whole = [awake(case(model, o)) for o in observations]
        trials = [replace(t, sigma=np.full(len(t.s), sigma), noise=noise) for t in whole]
        kept, _, _ = _cleared(trials, model, base.chi)
        first = self.of(kept, fit)
        begun = begun_anew(first[0], fit)
        return first if begun is first[0].trials else self.of(_begun(kept, begun), fit)


def prepared(
    model: Model,
    observations: Sequence[Observation],
    tolerance: float,
    rng: np.random.Generator,
    starts: int,
    progress: Progress,
    trusted: Sequence[str] = (),
) -> Prepared:
    """Data and base model. tolerance: [m] at the tip, to which simulation must tell a trial, if it is not trusted.

    Raises DataError where a trial cannot be used.
    """
    stated = all("sigma" in o.points for o in observations)
    whole = [case(resolved(model), o) for o in observations]
    moving = tuple(awake(t if stated else replace(t, sigma=np.full(len(t.s), GUESS))) for t in whole)
    likelihood, chi = _base(Likelihood(Data(moving), resolved(model)), rng, starts, progress)
    seen, trials = _cleaned(likelihood, chi, stated)
    hypothesis = Hypothesis(likelihood.model)
    data, doubt = corrected(trials, hypothesis, chi)
    sizes = likeliest(data.log_likelihoods(data.residuals(hypothesis.model, chi[None])))[:, 0]
    base = fitted(data, hypothesis, chi[None], sizes)
    resting = sum(len(t.s) for t in whole) - sum(len(t.s) for t in moving)
    first = Prepared(data, base, seen, trials, resting, doubt, stated=stated, trusted=tuple(trusted))
    made, base = converged(first, base)
    return _with_nearer_mesh(_without_chaotic(replace(made, base=base), tolerance), model, tolerance)


def converged(prepared: Prepared, fit: Fit) -> tuple[Prepared, Fit]:
    """Data with the numerical error of a fit, and the fit to these, until that gains no more: where a string whips, the
    error is another one at every step on the way."""
    for _ in range(PASSES):
        before = fit.evidence
        prepared, fit = nearer(prepared, fit)
        if fit.evidence < before + SETTLED:
            break
    return prepared, fit


def nearer(prepared: Prepared, fit: Fit) -> tuple[Prepared, Fit]:
    """One pass of `converged`, unless it leads away: numerical error as it is at the fit, and how it changes with the
    parameters, which a fit follows; then as it is there."""
    here = prepared.at(fit)
    if prepared.literal:
        return here, fitted(here.data, fit.hypothesis, fit.chi[None], fit.sizes)
    stays = evaluated(here.data, fit.hypothesis, fit.chi)
    finer = _finer(here, stays)
    chi = at_best(replace(here.data, finer=finer), fit.hypothesis, fit.chi[None], stays.sizes)
    there = here.at(replace(stays, chi=chi))
    there = replace(there, data=replace(there.data, finer=replace(finer, chi=chi)))
    moved = evaluated(there.data, fit.hypothesis, chi)
    return (there, moved) if moved.evidence > stays.evidence else (here, stays)


def _finer(prepared: Prepared, fit: Fit) -> Finer:
    """How numerical error changes with the parameters of a fit: by differences, of this mesh and of half of it,
    extrapolated. Not in trials that are not seen to be of first order at least: slopes of chaos lead astray."""
    hypothesis, data = fit.hypothesis, prepared.data
    width = solver.suited(data.of(hypothesis).white(fit.slopes, fit.sizes)[None], np.ones(1))[0]
    offset = np.where(fit.chi > 0.5, -width, width)
    chi = np.concatenate([fit.chi[None], fit.chi + np.diag(offset)])
    meshes = [on_mesh(hypothesis.model, data.trials, times) for times in (1, 2)]
    told = [Data(trials).residuals(model, chi) for model, trials in meshes]
    lost = [((own == LOST) | (half == LOST)).any(axis=0) for own, half in zip(*told, strict=True)]
    error = [np.where(gone, 0.0, extrapolated(*pair) - pair[0]) for gone, *pair in zip(lost, *told, strict=True)]
    known = prepared.doubt <= FIRST_ORDER * data.tip_rms([each[0] for each in error])
    slopes = [(each[1:] - each[0]) / offset[:, None] * own for each, own in zip(error, known, strict=True)]
    return Finer(tuple(hypothesis.model.names), fit.chi, tuple(slopes))


def _begun(trials: Sequence[Case], others: Sequence[Case]) -> tuple[Case, ...]:
    """Trials in the initial states of others."""
    pairs = zip(trials, others, strict=True)
    return tuple(replace(trial, initial=other.initial, change=other.change) for trial, other in pairs)


def usable(model: Model, observations: Sequence[Observation]) -> tuple[list[Observation], dict[str, str]]:
    """The trials that can be made ready, and why the others cannot, by name."""
    good, faults = [], {}
    for observation in observations:
        try:
            case(model, observation)
            good.append(observation)
        except DataError as error:
            faults[observation.trial] = str(error).removeprefix(f"trial {observation.trial}: ")
    return good, faults


def _configured(prepared: Prepared, model: Model) -> Fit | None:
    """The base model with the mesh as it is configured, at its best; None where that is the finer one."""
    string, fine = model.string, prepared.base.hypothesis.model.string
    if string.points > fine.points and string.tip_cell == fine.tip_cell:
        return None
    own = Hypothesis(replace(model, string=replace(string, ranges=fine.ranges)))
    pairs = zip(prepared.raw, prepared.data.trials, strict=True)
    alike = (replace(trial, model=own.model, error_model=other.discrepancy) for trial, other in pairs)
    data = Data(tuple(as_first_told(trial, trial.discrepancy.modes) for trial in alike))
    return fitted(data, own, own.carried(prepared.base.named)[None], prepared.base.sizes)


def _without_chaotic(prepared: Prepared, tolerance: float) -> Prepared:
    """Without trials so sensitive that what is in doubt of their numerical error is more than the tolerance: whatever
    they leave says nothing of causes. All of them where two or more others are not left."""
    names = [name for name in too_chaotic(prepared, tolerance) if name not in prepared.trusted]
    if not names:
        return prepared
    good = [k for k, trial in enumerate(prepared.raw) if trial.name not in names]
    base = replace(prepared.base, sizes=prepared.base.sizes[good])
    whole, raw = (tuple(some[k] for k in good) for some in (prepared.whole, prepared.raw))
    chaotic = (*prepared.chaotic, *names)
    kept = replace(prepared, whole=whole, raw=raw, data=prepared.data.only(good), chaotic=chaotic).at(base)
    return replace(kept, base=fitted(kept.data, base.hypothesis, base.chi[None], base.sizes))


def too_chaotic(prepared: Prepared, tolerance: float) -> list[str]:
    """Names of the trials whose numerical error is in doubt by as much as the tolerance [m], where two or more others
    are left."""
    names = [trial.name for trial, doubt in zip(prepared.raw, prepared.doubt, strict=True) if not doubt < tolerance]
    return names if len(prepared.raw) - len(names) >= FEWEST else []


def _with_nearer_mesh(prepared: Prepared, model: Model, tolerance: float) -> Prepared:
    """With the configured mesh as a part of the model, if the data are nearer to that and it leaves nothing to explain:
    they come from a simulation of such a chain."""
    own = _configured(prepared, model)
    if own is None or own.evidence < prepared.base.evidence + CLEARLY:
        return replace(prepared, configured=own)
    raw = tuple(replace(trial, model=own.hypothesis.model) for trial in prepared.raw)
    literal = replace(prepared, literal=True, raw=raw).at(own)
    fit = fitted(literal.data, own.hypothesis, own.chi[None], own.sizes)
    if literal.data.tip_rms(lacked(literal.data, fit)).max() > tolerance:
        return replace(prepared, configured=own)
    return replace(literal, base=fit)


def resolved(model: Model) -> Model:
    """With half cells at the ends and implicit steps, so that what mass points do is of second order."""
    string = replace(model.string, points=SEGMENTS + 1, tip_cell=0.5, grasp_cell=0.5)
    return replace(model, string=replace(string, integrator=ImplicitLeapfrog(), largest_step=STEP))


def searched_again(data: Data, fit: Fit, rng: np.random.Generator, starts: int) -> Fit:
    """The fit, or a better one from other strings: what was the base model's best may be a poor start with a cause."""
    hypothesis, own = fit.hypothesis, np.zeros(len(fit.chi), dtype=bool)
    for cause in hypothesis.causes:
        own[hypothesis.places(cause, cause.parameters)] = True
    drawn = np.where(own, fit.chi, rng.uniform(size=(8 * starts, len(fit.chi))))
    likelihood = Likelihood(Data(tuple(replace(t, model=hypothesis.model) for t in data.trials)), hypothesis.model)
    tried = np.concatenate([fit.chi[None], screened(likelihood, drawn, starts - 1)])
    chi = searched(likelihood, tried, MOST)
    other = fitted(data, hypothesis, chi[None], fit.sizes)
    return max(fit, other, key=lambda each: each.evidence)


def lacking(
    trials: Sequence[Case], hypothesis: Hypothesis, chi: np.ndarray, doubts: Sequence[np.ndarray] | None = None
) -> Data:
    """Data of trials, with what a hypothesis at exponents (P,) may lack in each. doubts: columns (2 n, D) over sigma of
    each, whose amplitudes are standard normal."""
    values = values_of(hypothesis.parameters, chi[None])[0]
    nothing = [np.zeros((2 * len(t.s), 0)) for t in trials]
    beginnings = modes(trials, values) or nothing
    nuisance = [np.hstack(pair) for pair in zip(beginnings, doubts or nothing, strict=True)]
    growth = _growth(trials, hypothesis, chi)
    told = [Discrepancy.of(*each) for each in zip(trials, growth, nuisance, strict=True)]
    begun = [as_first_told(*each) for each in zip(trials, beginnings, strict=True)]
    modelled = tuple(replace(trial, error_model=each) for trial, each in zip(begun, told, strict=True))
    return varying(Data(modelled), hypothesis, chi)


def corrected(trials: Sequence[Case], hypothesis: Hypothesis, chi: np.ndarray) -> tuple[Data, np.ndarray]:
    """Data without the numerical error of a hypothesis at exponents (P,), and what is in doubt of that at each tip [m].

    The error is taken off what was measured (deferred correction: Stetter 1978), so that simulations stay cheap. What
    is in doubt of it keeps its shape and may be more or less.
    """
    own = [replace(trial, model=hypothesis.model) for trial in trials]
    errors = _numerical_error(own, hypothesis, chi)
    moved = [replace(t, points=t.points - error) for t, (error, _) in zip(own, errors, strict=True)]
    over = [(doubt / t.sigma[:, None]).ravel() for t, (_, doubt) in zip(own, errors, strict=True)]
    data = lacking(moved, hypothesis, chi, [each[:, None] for each in over])
    return data, data.tip_rms(over)


def _base(
    likelihood: Likelihood, rng: np.random.Generator, starts: int, progress: Progress
) -> tuple[Likelihood, np.ndarray]:
    """The likelihood with ranges and initial states that suit the base model, and its best exponents (P,)."""
    parameters = likelihood.parameters
    start = chi_of(parameters, np.array([p.start for p in parameters]))
    tried = np.concatenate([start[None], rng.uniform(size=(8 * starts, len(start)))])
    chi = searched(likelihood, screened(likelihood, tried, starts), MOST, progress)
    for _ in range(WIDENINGS):
        before = likelihood
        for place in range(len(chi)):
            likelihood, chi = _widened(likelihood, chi, place)
        if likelihood is before:
            break
    return refined(likelihood, chi)


def _widened(likelihood: Likelihood, chi: np.ndarray, place: int) -> tuple[Likelihood, np.ndarray]:
    """With a wider range of the parameter at a place and the best exponents then, if it is one of the string's own that
    lies at an end of its range and this explains clearly more: what the data do not tell lies anywhere."""
    model, parameter = likelihood.model, likelihood.parameters[place]
    ranges = dict(model.string.ranges)
    free = parameter.name in ranges and parameter.low > 0 and parameter.name not in model.measured
    if not free or AT_END < chi[place] < 1 - AT_END:
        return likelihood, chi
    low, high = (parameter.low / WIDER, parameter.high) if chi[place] < 0.5 else (parameter.low, parameter.high * WIDER)
    ranges[parameter.name] = replace(ranges[parameter.name], low=low, high=high)
    wider = replace(model, string=replace(model.string, ranges=ranges))
    trials = [replace(trial, model=wider) for trial in likelihood.data.trials]
    start = chi_of(wider.parameters, values_of(likelihood.parameters, chi[None]))
    problem = with_noise(replace(likelihood.with_trials(trials), model=wider), start[0])
    before, after = problem.residuals(start)[0], solver.fitted(problem, start)
    gain = 0.5 * len(before) * np.log(np.mean(before**2) / after.loss[0])
    return (problem, after.chi[0]) if gain > CLEARLY else (likelihood, chi)


def _cleaned(likelihood: Likelihood, chi: np.ndarray, stated: bool) -> tuple[tuple[Case, ...], tuple[Case, ...]]:
    """Trials with the noise as sigma, and the same without outliers.

    Noise is what residuals have beside smooth motion, of which what the model lacks is a part.
    """
    kept, left, levels = _cleared(likelihood.data.trials, likelihood.model, chi)
    level = float(np.median(levels))
    factor = level if not stated or level > STATED_WRONG else 1.0
    pair = (likelihood.data.trials, kept)
    whole, raw = (tuple(replace(t, sigma=factor * t.sigma) for t in trials) for trials in pair)
    return whole, _heard(raw, [off / factor for off in left], stated)


def _heard(trials: Sequence[Case], residuals: Sequence[np.ndarray], stated: bool) -> tuple[Case, ...]:
    """Trials with the noise that residuals (n, 2) or (2 n,) over sigma tell; with a white one where it is less than is
    stated."""
    pairs = zip(trials, residuals, strict=True)
    noise = told([tracked_noise(trial, off.reshape(-1, 2)) for trial, off in pairs])
    noise = WHITE if stated and noise.of_means < 1 else noise
    return tuple(replace(trial, noise=noise) for trial in trials)


def _cleared(
    trials: Sequence[Case], model: Model, chi: np.ndarray
) -> tuple[tuple[Case, ...], tuple[np.ndarray, ...], tuple[float, ...]]:
    """Trials without outliers as a model at exponents (P,) tells them, and what `_without_outliers` says of each."""
    found = Data(tuple(trials)).residuals(model, chi[None])
    pairs = zip(trials, found, strict=True)
    kept, left, noise = zip(*(_without_outliers(trial, off.reshape(-1, 2)) for trial, off in pairs), strict=True)
    return kept, left, noise


def _without_outliers(trial: Case, residual: np.ndarray) -> tuple[Case, np.ndarray, float]:
    """A trial without the points whose residuals (n, 2) over sigma are far from smooth motion, the residuals of the
    others, and their noise over sigma."""
    noise = float("nan")
    for _ in range(HIDDEN):
        beside, noise = smoothed(trial, residual)
        near = np.linalg.norm(beside, axis=1) < OUTLYING * noise
        if near.all() or len(np.unique(trial.frame[near])) < FRAMES_NEEDED:
            break
        trial, residual = trial.only(near), residual[near]
    return trial, residual, noise


def _numerical_error(
    trials: Sequence[Case], hypothesis: Hypothesis, chi: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """By how much a string without mesh or step would be elsewhere at the measured points of each trial, and what is in
    doubt of that, (n, 2) [m] each.

    Meshes and steps are halved twice, and extrapolated from either pair (Richardson); pairs differ by what is in doubt.
    """
    errors = []
    for here, finer, finest in _on_meshes(trials, hypothesis, chi, (1, 2, 4)):
        limit = extrapolated(finer, finest)
        errors.append((np.nan_to_num(limit - here), np.nan_to_num(limit - extrapolated(here, finer))))
    return errors


def _on_meshes(
    trials: Sequence[Case], hypothesis: Hypothesis, chi: np.ndarray, finer: Sequence[int]
) -> list[tuple[np.ndarray, ...]]:
    """Where the string is at the measured points of each trial (n, 2) [m], on meshes and with steps so many times
    finer."""
    values, found = values_of(hypothesis.parameters, chi[None]), []
    for times in finer:
        model, own = on_mesh(hypothesis.model, trials, times)
        found.append([t.at_measured(seen)[0] for t, seen in zip(own, seen_together(model, own, values), strict=True)])
    return [*zip(*found, strict=True)]


def _growth(trials: Sequence[Case], hypothesis: Hypothesis, chi: np.ndarray) -> list[np.ndarray]:
    """How a small change of the model's parameters has grown by each frame, (F,): root mean square over the points and
    over the parameters, each scaled alike."""
    offset = np.where(chi > 0.5, -solver.FIRST, solver.FIRST)
    tried = values_of(hypothesis.parameters, np.concatenate([chi[None], chi + np.diag(offset)]))
    found = []
    for trial, seen in zip(trials, seen_together(hypothesis.model, trials, tried), strict=True):
        here, *beside = np.nan_to_num(trial.at_measured(seen))
        square = np.sum((np.stack(beside) - here) ** 2, axis=-1)
        scaled = np.mean(square / np.maximum(square.mean(axis=1, keepdims=True), np.finfo(float).tiny), axis=0)
        count = np.maximum(np.bincount(trial.frame, minlength=len(trial.times)), 1)
        by_frame = np.sqrt(np.bincount(trial.frame, scaled, minlength=len(trial.times)) / count)
        grown = np.maximum.accumulate(by_frame)
        found.append(np.maximum(grown, LEAST_GROWTH * grown[-1]))
    return found


def awake(trial: Case) -> Case:
    """Without its end, in which the string hangs still: what a few frames say, a thousand must not say anew."""
    away = np.zeros(len(trial.times))
    late = trial.times[trial.frame] > trial.times[-1] - RESTING
    for track in tracked(trial.frame, trial.s):
        if late[track].any():
            end = np.median(trial.points[track[late[track]]], axis=0)
            np.maximum.at(away, trial.frame[track], np.linalg.norm(trial.points[track] - end, axis=1))
    moving = np.flatnonzero(away > STILL * trial.model.string.length)
    last = trial.times[moving[-1]] if moving.size else trial.times[0]
    return trial.until(max(last + RESTING, trial.times[:FRAMES_NEEDED][-1]))
