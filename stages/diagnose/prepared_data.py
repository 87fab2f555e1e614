"""From trials to data: the base model at its best, noise, outliers, numerical error,
and what may be lacking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.data.dataset import MIN_FRAMES
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, track_places
from stringcast.stages.diagnose.random_effects import with_random_effects
from stringcast.stages.inference import solver
from stringcast.stages.inference.batch import simulate_trials
from stringcast.stages.inference.discrepancy import (
    Discrepancy,
    best_scale_index,
    noise_track_of_trial,
    remove_smooth_motion,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.initial_modes import (
    initial_mode_columns,
    reset_initial_state_linear,
    trials_with_reestimated_start,
)
from stringcast.stages.inference.laplace import (
    Fit,
    best_exponents,
    evaluate_fit,
    fit_hypothesis,
    mean_discrepancy,
)
from stringcast.stages.inference.likelihood import MOTION_SHARE, Likelihood
from stringcast.stages.inference.mesh import refine_mesh
from stringcast.stages.inference.mesh_correction import MeshCorrection
from stringcast.stages.inference.noise import WHITE_NOISE, fit_noise_model
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
    with_estimated_noise,
)
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.engine.accuracy import richardson_limit
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents, parameter_values

# [s]: 1 mm of error at the tip in a plain cast, which is corrected
SEGMENTS, STEP_S = 20, 1e-3
INITIAL_NOISE_M = 1e-3  # [m] of noise before anything is known
# times the noise that the data's author states: then the data are believed
OVERRULING_NOISE_RATIO = 1.3
OUTLIER_SIGMAS = 6.0  # noises from smooth motion: one point in 5e8 by chance
OUTLIER_PASSES = 3  # times that outliers are looked for: one may hide another
# of outliers: if fewer are so beside a better model, the poorer one made them
OUTLIER_RETENTION = 0.5
MAX_CORRECTION_PASSES = 8  # of numerical error and fit at most: it mostly takes two
# of a range; times as wide on that side; in turns
RANGE_END_FRACTION, RANGE_WIDENING_FACTOR, MAX_WIDENING_ROUNDS = 0.02, 30.0, 3
MIN_RESOLVED_TRIALS = 2  # trials: what is found in one could not be checked on another
# of what is extrapolated, in doubt: |4 / 2^p - 1| / 4 where halving the mesh is of
# order p
MAX_UNCERTAINTY_RATIO = 0.25
STRONG_LOG_EVIDENCE = 5.0  # of the log evidence: strong, by Jeffreys' scale
# of the log evidence: to gain less is not worth a mention, by the same
NEGLIGIBLE_LOG_EVIDENCE = 1.0
MAX_SEARCH_ITERATIONS = 20  # iterations of the search before its last horizon
MIN_RELATIVE_SENSITIVITY = 0.1  # of the largest: early frames are not exact either
KEPT_REST_S = 0.2  # [s] that are kept of a string at rest


@dataclass(frozen=True)
class PreparedData:
    """What a search for causes starts from.

    data: with noise and numerical error. base: the base model at its best. whole: the
    trials with their outliers. raw: without them, before numerical error was taken off.
    resting: points left out, at rest. doubt: of numerical error at the tip of each
    trial [m]. literal: the mesh is a part of the model, and has no error. chaotic:
    names of trials that no simulation tells to the tolerance; trusted: of those that
    one with causes tells. configured: the base model with the mesh as it is configured,
    at its best; None where that is the finer one. stated: the data's author states
    their noise.
    """

    data: TrialData
    base_fit: Fit
    trials_with_outliers: tuple[PreparedTrial, ...]
    trials: tuple[PreparedTrial, ...]
    resting_points: int
    discretisation_uncertainty_m: np.ndarray
    mesh_is_model: bool = False
    chaotic_trials: tuple[str, ...] = ()
    configured_mesh_fit: Fit | None = None
    noise_is_given: bool = False
    keep_if_chaotic: tuple[str, ...] = ()

    def with_corrections_at(self, fit: Fit) -> PreparedData:
        """With numerical error and what may be lacking as they are at a fit."""
        raw = with_initial_states_of(
            self.trials, trials_with_reestimated_start(self.data, fit)
        )
        data, doubt = self.corrected_data_of(raw, fit)
        return replace(
            self,
            trials=raw,
            data=replace(data, mesh_correction=self._mesh_correction_at(fit)),
            discretisation_uncertainty_m=doubt,
        )

    def _mesh_correction_at(self, fit: Fit) -> MeshCorrection | None:
        finer = None if self.mesh_is_model else self.data.mesh_correction
        return finer and finer.centred_at(fit.exponents)

    @property
    def point_counts(self) -> list[int]:
        """How many points of each trial causes are sought in."""
        return [len(trial.s) for trial in self.trials]

    @property
    def outlier_count(self) -> int:
        """How many points are left out for being far from smooth motion."""
        return sum(len(trial.s) for trial in self.trials_with_outliers) - sum(
            self.point_counts
        )

    def with_reestimated_noise(self, fit: Fit) -> PreparedData:
        """With noise as what a fit leaves tells it, and with outliers if most of them
        are none: what a poorer model lacks may have sounded like noise, and where the
        string whips it may have looked like outliers.
        """
        if self.outlier_count:
            whole = with_initial_states_of(
                self.trials_with_outliers, trials_with_reestimated_start(self.data, fit)
            )
            kept, left, _ = remove_outliers(whole, fit.hypothesis.model, fit.chi)
            anew = replace(
                self,
                trials_with_outliers=whole,
                trials=kept,
                data=replace(self.data, mesh_correction=None),
            )
            if anew.outlier_count < OUTLIER_RETENTION * self.outlier_count:
                return replace(
                    anew, trials=estimate_noise(kept, left, self.noise_is_given)
                )
        return replace(
            self, trials=estimate_noise(self.trials, fit.residuals, self.noise_is_given)
        )

    def one_mesh_corrected_data(self, fit: Fit) -> TrialData:
        """Data without the numerical error of a fit as one finer mesh tells it; what
        may be lacking is as before, which tells at a tenth of the cost of `at` whether
        a fit is worth more.
        """
        if self.mesh_is_model:
            return self.data
        pairs = simulate_on_meshes(self.trials, fit.hypothesis, fit.chi, (1, 2))
        told = zip(self.data.trials, self.trials, pairs, strict=True)
        exact = (
            replace(t, points=r.points - np.nan_to_num(richardson_limit(a, b) - a))
            for t, r, (a, b) in told
        )
        trials = tuple(
            reset_initial_state_linear(trial, trial.discrepancy.nuisance_shapes)
            for trial in exact
        )
        return replace(
            self.data, trials=trials, mesh_correction=self._mesh_correction_at(fit)
        )

    def corrected_data_of(
        self, trials: Sequence[PreparedTrial], fit: Fit
    ) -> tuple[TrialData, np.ndarray]:
        """Data of any trials without the numerical error of a fit, and what is in doubt
        of that at each tip [m].
        """
        own = [replace(trial, model=fit.hypothesis.model) for trial in trials]
        if self.mesh_is_model:
            return attach_discrepancy_model(own, fit.hypothesis, fit.chi), np.zeros(
                len(own)
            )
        return subtract_discretisation_error(own, fit.hypothesis, fit.chi)

    def prepare_further_trials(
        self, observations: Sequence[Observation], fit: Fit
    ) -> tuple[TrialData, np.ndarray]:
        """Data of further trials, with the noise of these and without a fit's numerical
        error, and what is in doubt of that at each tip [m].
        """
        base, sigma = (
            self.base_fit,
            float(np.median(np.concatenate([trial.sigma for trial in self.trials]))),
        )
        model, noise = base.hypothesis.model, self.trials[0].noise
        whole = [trim_trailing_rest(prepare_trial(model, o)) for o in observations]
        trials = [
            replace(t, sigma=np.full(len(t.s), sigma), noise=noise) for t in whole
        ]
        kept, _, _ = remove_outliers(trials, model, base.chi)
        first = self.corrected_data_of(kept, fit)
        begun = trials_with_reestimated_start(first[0], fit)
        return (
            first
            if begun is first[0].trials
            else self.corrected_data_of(with_initial_states_of(kept, begun), fit)
        )


def prepare_data(
    model: Model,
    observations: Sequence[Observation],
    tolerance: float,
    rng: np.random.Generator,
    starts: int,
    progress: Progress,
    trusted: Sequence[str] = (),
) -> PreparedData:
    """Data and base model. tolerance: [m] at the tip, to which simulation must tell a
    trial, if it is not trusted.

    Raises DataError where a trial cannot be used.
    """
    stated = all("sigma" in o.points for o in observations)
    whole = [prepare_trial(with_second_order_mesh(model), o) for o in observations]
    moving = tuple(
        trim_trailing_rest(
            t if stated else replace(t, sigma=np.full(len(t.s), INITIAL_NOISE_M))
        )
        for t in whole
    )
    likelihood, chi = fit_base_model(
        Likelihood(TrialData(moving), with_second_order_mesh(model)),
        rng,
        starts,
        progress,
    )
    seen, trials = estimate_initial_noise(likelihood, chi, stated)
    hypothesis = Hypothesis(likelihood.model)
    data, doubt = subtract_discretisation_error(trials, hypothesis, chi)
    sizes = best_scale_index(
        data.log_likelihood_by_scale(data.residuals(hypothesis.model, chi[None]))
    )[:, 0]
    base = fit_hypothesis(data, hypothesis, chi[None], sizes)
    resting = sum(len(t.s) for t in whole) - sum(len(t.s) for t in moving)
    first = PreparedData(
        data,
        base,
        seen,
        trials,
        resting,
        doubt,
        noise_is_given=stated,
        keep_if_chaotic=tuple(trusted),
    )
    made, base = refine_to_convergence(first, base)
    return keep_configured_mesh_if_supported(
        exclude_chaotic_trials(replace(made, base_fit=base), tolerance),
        model,
        tolerance,
    )


def refine_to_convergence(prepared: PreparedData, fit: Fit) -> tuple[PreparedData, Fit]:
    """Data with the numerical error of a fit, and the fit to these, until that gains no
    more: where a string whips, the error is another one at every step on the way.
    """
    for _ in range(MAX_CORRECTION_PASSES):
        before = fit.log_evidence
        prepared, fit = correct_discretisation_once(prepared, fit)
        if fit.log_evidence < before + NEGLIGIBLE_LOG_EVIDENCE:
            break
    return prepared, fit


def correct_discretisation_once(
    prepared: PreparedData, fit: Fit
) -> tuple[PreparedData, Fit]:
    """One pass of `converged`, unless it leads away: numerical error as it is at the
    fit, and how it changes with the parameters, which a fit follows; then as it is
    there.
    """
    here = prepared.with_corrections_at(fit)
    if prepared.mesh_is_model:
        return here, fit_hypothesis(
            here.data, fit.hypothesis, fit.chi[None], fit.scale_indices
        )
    stays = evaluate_fit(here.data, fit.hypothesis, fit.chi)
    finer = fit_mesh_correction(here, stays)
    chi = best_exponents(
        replace(here.data, mesh_correction=finer),
        fit.hypothesis,
        fit.chi[None],
        stays.scale_indices,
    )
    there = here.with_corrections_at(replace(stays, chi=chi))
    there = replace(
        there, data=replace(there.data, mesh_correction=replace(finer, chi=chi))
    )
    moved = evaluate_fit(there.data, fit.hypothesis, chi)
    return (there, moved) if moved.log_evidence > stays.log_evidence else (here, stays)


def fit_mesh_correction(prepared: PreparedData, fit: Fit) -> MeshCorrection:
    """How numerical error changes with the parameters of a fit: by differences, of this
    mesh and of half of it, extrapolated. Not in trials that are not seen to be of first
    order at least: slopes of chaos lead astray.
    """
    hypothesis, data = fit.hypothesis, prepared.data
    width = solver.difference_widths(
        data.for_hypothesis(hypothesis).whiten(fit.slopes, fit.scale_indices)[None],
        np.ones(1),
    )[0]
    offset = np.where(fit.chi > 0.5, -width, width)
    chi = np.concatenate([fit.chi[None], fit.chi + np.diag(offset)])
    meshes = [refine_mesh(hypothesis.model, data.trials, times) for times in (1, 2)]
    told = [TrialData(trials).residuals(model, chi) for model, trials in meshes]
    lost = [
        ((own == DIVERGED_RESIDUAL) | (half == DIVERGED_RESIDUAL)).any(axis=0)
        for own, half in zip(*told, strict=True)
    ]
    error = [
        np.where(gone, 0.0, richardson_limit(*pair) - pair[0])
        for gone, *pair in zip(lost, *told, strict=True)
    ]
    known = (
        prepared.discretisation_uncertainty_m
        <= MAX_UNCERTAINTY_RATIO * data.tip_rms_by_trial([each[0] for each in error])
    )
    slopes = [
        (each[1:] - each[0]) / offset[:, None] * own
        for each, own in zip(error, known, strict=True)
    ]
    return MeshCorrection(tuple(hypothesis.model.names), fit.chi, tuple(slopes))


def with_initial_states_of(
    trials: Sequence[PreparedTrial], others: Sequence[PreparedTrial]
) -> tuple[PreparedTrial, ...]:
    """Trials in the initial states of others."""
    pairs = zip(trials, others, strict=True)
    return tuple(
        replace(
            trial,
            initial_state=other.initial_state,
            mode_amplitudes=other.mode_amplitudes,
        )
        for trial, other in pairs
    )


def usable_trials(
    model: Model, observations: Sequence[Observation]
) -> tuple[list[Observation], dict[str, str]]:
    """The trials that can be made ready, and why the others cannot, by name."""
    good, faults = [], {}
    for observation in observations:
        try:
            prepare_trial(model, observation)
            good.append(observation)
        except DataError as error:
            faults[observation.trial] = str(error).removeprefix(
                f"trial {observation.trial}: "
            )
    return good, faults


def _fit_configured_mesh(prepared: PreparedData, model: Model) -> Fit | None:
    """The base model with the mesh as it is configured, at its best; None where that is
    the finer one.
    """
    string, fine = model.string, prepared.base_fit.hypothesis.model.string
    if string.points > fine.points and string.tip_cell == fine.tip_cell:
        return None
    own = Hypothesis(replace(model, string=replace(string, ranges=fine.ranges)))
    pairs = zip(prepared.trials, prepared.data.trials, strict=True)
    alike = (
        replace(trial, model=own.model, error_model=other.discrepancy)
        for trial, other in pairs
    )
    data = TrialData(
        tuple(
            reset_initial_state_linear(trial, trial.discrepancy.nuisance_shapes)
            for trial in alike
        )
    )
    return fit_hypothesis(
        data,
        own,
        own.exponents_from(prepared.base_fit.exponents)[None],
        prepared.base_fit.scale_indices,
    )


def exclude_chaotic_trials(prepared: PreparedData, tolerance: float) -> PreparedData:
    """Without trials so sensitive that what is in doubt of their numerical error is
    more than the tolerance: whatever they leave says nothing of causes. All of them
    where two or more others are not left.
    """
    names = [
        name
        for name in unresolvable_trials(prepared, tolerance)
        if name not in prepared.keep_if_chaotic
    ]
    if not names:
        return prepared
    good = [k for k, trial in enumerate(prepared.trials) if trial.name not in names]
    base = replace(
        prepared.base_fit, scale_indices=prepared.base_fit.scale_indices[good]
    )
    whole, raw = (
        tuple(some[k] for k in good)
        for some in (prepared.trials_with_outliers, prepared.trials)
    )
    chaotic = (*prepared.chaotic_trials, *names)
    kept = replace(
        prepared,
        trials_with_outliers=whole,
        trials=raw,
        data=prepared.data.subset(good),
        chaotic_trials=chaotic,
    ).with_corrections_at(base)
    return replace(
        kept,
        base_fit=fit_hypothesis(
            kept.data, base.hypothesis, base.chi[None], base.scale_indices
        ),
    )


def unresolvable_trials(prepared: PreparedData, tolerance: float) -> list[str]:
    """Names of the trials whose numerical error is in doubt by as much as the tolerance
    [m], where two or more others are left.
    """
    names = [
        trial.name
        for trial, doubt in zip(
            prepared.trials, prepared.discretisation_uncertainty_m, strict=True
        )
        if not doubt < tolerance
    ]
    return names if len(prepared.trials) - len(names) >= MIN_RESOLVED_TRIALS else []


def keep_configured_mesh_if_supported(
    prepared: PreparedData, model: Model, tolerance: float
) -> PreparedData:
    """With the configured mesh as a part of the model, if the data are nearer to that
    and it leaves nothing to explain: they come from a simulation of such a chain.
    """
    own = _fit_configured_mesh(prepared, model)
    if (
        own is None
        or own.log_evidence < prepared.base_fit.log_evidence + STRONG_LOG_EVIDENCE
    ):
        return replace(prepared, configured_mesh_fit=own)
    raw = tuple(replace(trial, model=own.hypothesis.model) for trial in prepared.trials)
    literal = replace(prepared, mesh_is_model=True, trials=raw).with_corrections_at(own)
    fit = fit_hypothesis(literal.data, own.hypothesis, own.chi[None], own.scale_indices)
    if (
        literal.data.tip_rms_by_trial(mean_discrepancy(literal.data, fit)).max()
        > tolerance
    ):
        return replace(prepared, configured_mesh_fit=own)
    return replace(literal, base_fit=fit)


def with_second_order_mesh(model: Model) -> Model:
    """With half cells at the ends and implicit steps, so that what mass points do is of
    second order.
    """
    string = replace(model.string, points=SEGMENTS + 1, tip_cell=0.5, grasp_cell=0.5)
    return replace(
        model,
        string=replace(string, integrator=ImplicitLeapfrog(), largest_step=STEP_S),
    )


def refit_from_new_starts(
    data: TrialData, fit: Fit, rng: np.random.Generator, starts: int
) -> Fit:
    """The fit, or a better one from other strings: what was the base model's best may
    be a poor start with a cause.
    """
    hypothesis, own = fit.hypothesis, np.zeros(len(fit.chi), dtype=bool)
    for cause in hypothesis.causes:
        own[hypothesis.parameter_indices(cause, cause.parameters)] = True
    drawn = np.where(own, fit.chi, rng.uniform(size=(8 * starts, len(fit.chi))))
    likelihood = Likelihood(
        TrialData(tuple(replace(t, model=hypothesis.model) for t in data.trials)),
        hypothesis.model,
    )
    tried = np.concatenate(
        [fit.chi[None], screen_candidates(likelihood, drawn, starts - 1)]
    )
    chi = search_parameters(likelihood, tried, MAX_SEARCH_ITERATIONS)
    other = fit_hypothesis(data, hypothesis, chi[None], fit.scale_indices)
    return max(fit, other, key=lambda each: each.log_evidence)


def attach_discrepancy_model(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
    doubts: Sequence[np.ndarray] | None = None,
) -> TrialData:
    """Data of trials, with what a hypothesis at exponents (P,) may lack in each.
    doubts: columns (2 n, D) over sigma of each, whose amplitudes are standard normal.
    """
    values = parameter_values(hypothesis.parameters, chi[None])[0]
    nothing = [np.zeros((2 * len(t.s), 0)) for t in trials]
    beginnings = initial_mode_columns(trials, values) or nothing
    nuisance = [
        np.hstack(pair) for pair in zip(beginnings, doubts or nothing, strict=True)
    ]
    growth = sensitivity_by_frame(trials, hypothesis, chi)
    told = [
        Discrepancy.for_trial(*each)
        for each in zip(trials, growth, nuisance, strict=True)
    ]
    begun = [
        reset_initial_state_linear(*each)
        for each in zip(trials, beginnings, strict=True)
    ]
    modelled = tuple(
        replace(trial, error_model=each)
        for trial, each in zip(begun, told, strict=True)
    )
    return with_random_effects(TrialData(modelled), hypothesis, chi)


def subtract_discretisation_error(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> tuple[TrialData, np.ndarray]:
    """Data without the numerical error of a hypothesis at exponents (P,), and what is
    in doubt of that at each tip [m].

    The error is taken off what was measured (deferred correction: Stetter 1978), so
    that simulations stay cheap. What is in doubt of it keeps its shape and may be more
    or less.
    """
    own = [replace(trial, model=hypothesis.model) for trial in trials]
    errors = discretisation_errors(own, hypothesis, chi)
    moved = [
        replace(t, points=t.points - error)
        for t, (error, _) in zip(own, errors, strict=True)
    ]
    over = [
        (doubt / t.sigma[:, None]).ravel()
        for t, (_, doubt) in zip(own, errors, strict=True)
    ]
    data = attach_discrepancy_model(
        moved, hypothesis, chi, [each[:, None] for each in over]
    )
    return data, data.tip_rms_by_trial(over)


def fit_base_model(
    likelihood: Likelihood, rng: np.random.Generator, starts: int, progress: Progress
) -> tuple[Likelihood, np.ndarray]:
    """The likelihood with ranges and initial states that suit the base model, and its
    best exponents (P,).
    """
    parameters = likelihood.parameters
    start = parameter_exponents(parameters, np.array([p.start for p in parameters]))
    tried = np.concatenate([start[None], rng.uniform(size=(8 * starts, len(start)))])
    chi = search_parameters(
        likelihood,
        screen_candidates(likelihood, tried, starts),
        MAX_SEARCH_ITERATIONS,
        progress,
    )
    for _ in range(MAX_WIDENING_ROUNDS):
        before = likelihood
        for place in range(len(chi)):
            likelihood, chi = widen_range_if_supported(likelihood, chi, place)
        if likelihood is before:
            break
    return refine_solution(likelihood, chi)


def widen_range_if_supported(
    likelihood: Likelihood, chi: np.ndarray, place: int
) -> tuple[Likelihood, np.ndarray]:
    """With a wider range of the parameter at a place and the best exponents then, if it
    is one of the string's own that lies at an end of its range and this explains
    clearly more: what the data do not tell lies anywhere.
    """
    model, parameter = likelihood.model, likelihood.parameters[place]
    ranges = dict(model.string.ranges)
    free = (
        parameter.name in ranges
        and parameter.low > 0
        and parameter.name not in model.measured_ranges
    )
    if not free or RANGE_END_FRACTION < chi[place] < 1 - RANGE_END_FRACTION:
        return likelihood, chi
    low, high = (
        (parameter.low / RANGE_WIDENING_FACTOR, parameter.high)
        if chi[place] < 0.5
        else (parameter.low, parameter.high * RANGE_WIDENING_FACTOR)
    )
    ranges[parameter.name] = replace(ranges[parameter.name], low=low, high=high)
    wider = replace(model, string=replace(model.string, ranges=ranges))
    trials = [replace(trial, model=wider) for trial in likelihood.data.trials]
    start = parameter_exponents(
        wider.parameters, parameter_values(likelihood.parameters, chi[None])
    )
    problem = with_estimated_noise(
        replace(likelihood.with_trials(trials), model=wider), start[0]
    )
    before, after = (
        problem.residuals(start)[0],
        solver.fit_least_squares(problem, start),
    )
    gain = 0.5 * len(before) * np.log(np.mean(before**2) / after.loss[0])
    return (problem, after.chi[0]) if gain > STRONG_LOG_EVIDENCE else (likelihood, chi)


def estimate_initial_noise(
    likelihood: Likelihood, chi: np.ndarray, stated: bool
) -> tuple[tuple[PreparedTrial, ...], tuple[PreparedTrial, ...]]:
    """Trials with the noise as sigma, and the same without outliers.

    Noise is what residuals have beside smooth motion, of which what the model lacks is
    a part.
    """
    kept, left, levels = remove_outliers(likelihood.data.trials, likelihood.model, chi)
    level = float(np.median(levels))
    factor = level if not stated or level > OVERRULING_NOISE_RATIO else 1.0
    pair = (likelihood.data.trials, kept)
    whole, raw = (
        tuple(replace(t, sigma=factor * t.sigma) for t in trials) for trials in pair
    )
    return whole, estimate_noise(raw, [off / factor for off in left], stated)


def estimate_noise(
    trials: Sequence[PreparedTrial], residuals: Sequence[np.ndarray], stated: bool
) -> tuple[PreparedTrial, ...]:
    """Trials with the noise that residuals (n, 2) or (2 n,) over sigma tell; with a
    white one where it is less than is stated.
    """
    pairs = zip(trials, residuals, strict=True)
    noise = fit_noise_model(
        [noise_track_of_trial(trial, off.reshape(-1, 2)) for trial, off in pairs]
    )
    noise = WHITE_NOISE if stated and noise.variance_of_means < 1 else noise
    return tuple(replace(trial, noise=noise) for trial in trials)


def remove_outliers(
    trials: Sequence[PreparedTrial], model: Model, chi: np.ndarray
) -> tuple[tuple[PreparedTrial, ...], tuple[np.ndarray, ...], tuple[float, ...]]:
    """Trials without outliers as a model at exponents (P,) tells them, and what
    `_without_outliers` says of each.
    """
    found = TrialData(tuple(trials)).residuals(model, chi[None])
    pairs = zip(trials, found, strict=True)
    kept, left, noise = zip(
        *(_remove_trial_outliers(trial, off.reshape(-1, 2)) for trial, off in pairs),
        strict=True,
    )
    return kept, left, noise


def _remove_trial_outliers(
    trial: PreparedTrial, residual: np.ndarray
) -> tuple[PreparedTrial, np.ndarray, float]:
    """A trial without the points whose residuals (n, 2) over sigma are far from smooth
    motion, the residuals of the others, and their noise over sigma.
    """
    noise = float("nan")
    for _ in range(OUTLIER_PASSES):
        beside, noise = remove_smooth_motion(trial, residual)
        near = np.linalg.norm(beside, axis=1) < OUTLIER_SIGMAS * noise
        if near.all() or len(np.unique(trial.frame[near])) < MIN_FRAMES:
            break
        trial, residual = trial.select_points(near), residual[near]
    return trial, residual, noise


def discretisation_errors(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """By how much a string without mesh or step would be elsewhere at the measured
    points of each trial, and what is in doubt of that, (n, 2) [m] each.

    Meshes and steps are halved twice, and extrapolated from either pair (Richardson);
    pairs differ by what is in doubt.
    """
    errors = []
    for here, finer, finest in simulate_on_meshes(trials, hypothesis, chi, (1, 2, 4)):
        limit = richardson_limit(finer, finest)
        errors.append(
            (
                np.nan_to_num(limit - here),
                np.nan_to_num(limit - richardson_limit(here, finer)),
            )
        )
    return errors


def simulate_on_meshes(
    trials: Sequence[PreparedTrial],
    hypothesis: Hypothesis,
    chi: np.ndarray,
    finer: Sequence[int],
) -> list[tuple[np.ndarray, ...]]:
    """Where the string is at the measured points of each trial (n, 2) [m], on meshes
    and with steps so many times finer.
    """
    values, found = parameter_values(hypothesis.parameters, chi[None]), []
    for times in finer:
        model, own = refine_mesh(hypothesis.model, trials, times)
        found.append(
            [
                t.sample_at_points(seen)[0]
                for t, seen in zip(
                    own, simulate_trials(model, own, values), strict=True
                )
            ]
        )
    return [*zip(*found, strict=True)]


def sensitivity_by_frame(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> list[np.ndarray]:
    """How a small change of the model's parameters has grown by each frame, (F,): root
    mean square over the points and over the parameters, each scaled alike.
    """
    offset = np.where(chi > 0.5, -solver.FIRST_DIFFERENCE, solver.FIRST_DIFFERENCE)
    tried = parameter_values(
        hypothesis.parameters, np.concatenate([chi[None], chi + np.diag(offset)])
    )
    found = []
    for trial, seen in zip(
        trials, simulate_trials(hypothesis.model, trials, tried), strict=True
    ):
        here, *beside = np.nan_to_num(trial.sample_at_points(seen))
        square = np.sum((np.stack(beside) - here) ** 2, axis=-1)
        scaled = np.mean(
            square
            / np.maximum(square.mean(axis=1, keepdims=True), np.finfo(float).tiny),
            axis=0,
        )
        count = np.maximum(np.bincount(trial.frame, minlength=len(trial.times)), 1)
        by_frame = np.sqrt(
            np.bincount(trial.frame, scaled, minlength=len(trial.times)) / count
        )
        grown = np.maximum.accumulate(by_frame)
        found.append(np.maximum(grown, MIN_RELATIVE_SENSITIVITY * grown[-1]))
    return found


def trim_trailing_rest(trial: PreparedTrial) -> PreparedTrial:
    """Without its end, in which the string hangs still: what a few frames say, a
    thousand must not say anew.
    """
    away = np.zeros(len(trial.times))
    late = trial.times[trial.frame] > trial.times[-1] - KEPT_REST_S
    for track in track_places(trial.frame, trial.s):
        if late[track].any():
            end = np.median(trial.points[track[late[track]]], axis=0)
            np.maximum.at(
                away,
                trial.frame[track],
                np.linalg.norm(trial.points[track] - end, axis=1),
            )
    moving = np.flatnonzero(away > MOTION_SHARE * trial.model.string.length)
    last = trial.times[moving[-1]] if moving.size else trial.times[0]
    return trial.cut_after(max(last + KEPT_REST_S, trial.times[:MIN_FRAMES][-1]))
