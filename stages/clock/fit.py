"""The string model fitted with the clock offset as a parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.clocks.clock_offsets import (
    DRIFT,
    OFFSET,
    ClockFit,
    better_fit,
    explained_fraction,
)
from stringcast.stages.diagnose.trials.base_model import (
    fit_base_model,
    fit_from_beginnings,
)
from stringcast.stages.diagnose.trials.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.trials.noise import estimate_initial_noise
from stringcast.stages.diagnose.trials.preparation import INITIAL_NOISE_M
from stringcast.stages.diagnose.trials.used_frames import trim_trailing_rest
from stringcast.stages.inference import solver
from stringcast.stages.inference.discrepancy_grid import most_likely_grid_point
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.inference.likelihood import PRIOR_PRECISION, Likelihood
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.clock_drift import ClockDrift
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.model import Model

STARTS = 6  # of the search for the string's parameters and the offset
FIXED_WITHIN_S = 1e-4  # half range of an offset that is given
MAX_DRIFT = 0.35  # of the clocks within trials, as a share of time
PROFILE_SIZE = 41  # offsets at which the likelihood is profiled


def model_with_offset(model: Model, half_width: float) -> Model:
    """Return the model with an offset in a range around zero [s]."""
    if TimeOffset not in model.clock_effects:
        model = model.with_effects(TimeOffset)
    ranges = {**model.measured_ranges, OFFSET: (-half_width, half_width)}
    return replace(model, measured_ranges=ranges)


def fit_clock(
    model: Model,
    observations: Sequence[Observation],
    half_width: float,
    rng: np.random.Generator,
    progress: Progress,
) -> ClockFit:
    """Fit the string's parameters and one offset, in a range around zero.

    Numerical error is not corrected: it moves the tip by a millimetre at most, which
    the discrepancy includes.
    """
    model = model_with_offset(model, half_width)
    second_order = with_second_order_mesh(model)
    noise_is_given = all("sigma" in o.points for o in observations)
    trials = []
    for observation in observations:
        trial = prepare_trial(second_order, observation)
        if not noise_is_given:
            trial = replace(trial, sigma=np.full(len(trial.s), INITIAL_NOISE_M))
        trials.append(trim_trailing_rest(trial))
    likelihood = Likelihood(TrialData(tuple(trials)), second_order)
    likelihood, chi = fit_base_model(likelihood, rng, STARTS, progress)
    _, measured = estimate_initial_noise(likelihood, chi, noise_is_given)
    clock = _fit_with_discrepancy(measured, Hypothesis(likelihood.model), chi)
    restarted = replace(clock, fit=fit_from_beginnings(clock.data, clock.fit))
    return better_fit(clock, restarted)


def _fit_with_discrepancy(
    trials: Sequence[PreparedTrial], hypothesis: Hypothesis, chi: np.ndarray
) -> ClockFit:
    """Attach the discrepancy to trials at exponents (P,), and fit from there."""
    data = attach_discrepancy_model(trials, hypothesis, chi)
    residuals = data.residuals(hypothesis.model, chi[None])
    by_grid_point = data.log_likelihood_by_grid_point(residuals)[:, 0]
    grid_points = most_likely_grid_point(by_grid_point)
    return ClockFit(data, fit_hypothesis(data, hypothesis, chi[None], grid_points))


def fit_drift(clock: ClockFit) -> ClockFit:
    """Fit a drift of the clocks in addition to the offset, from a fit without it.

    Its range includes wrong frame rates. The offset is that at t = 0.
    """
    hypothesis = clock.fit.hypothesis
    drifting = hypothesis.base.with_effects(ClockDrift)
    duration_s = max(float(trial.times[-1]) for trial in clock.data.trials)
    low, high = drifting.measured_ranges[OFFSET]
    ranges = {
        **drifting.measured_ranges,
        OFFSET: (low - MAX_DRIFT * duration_s, high + MAX_DRIFT * duration_s),
        DRIFT: (-MAX_DRIFT, MAX_DRIFT),
    }
    hypothesis = replace(hypothesis, base=replace(drifting, measured_ranges=ranges))
    start = hypothesis.model.exponents_of_values(clock.fit.values | {DRIFT: 0.0})
    fit = fit_hypothesis(clock.data, hypothesis, start[None], clock.fit.grid_points)
    return ClockFit(clock.data, fit)


def explained_by_offset(clock: ClockFit, other: float) -> float:
    """Compute the share of the misfit at the tip that the fit's offset removes.

    other: offset for comparison [s]; the string is refitted with it.
    """
    fit = clock.fit
    model = fit.hypothesis.base
    fixed = {OFFSET: (other - FIXED_WITHIN_S, other + FIXED_WITHIN_S)}
    fixed_model = replace(model, measured_ranges={**model.measured_ranges, **fixed})
    hypothesis = replace(fit.hypothesis, base=fixed_model)
    start = hypothesis.exponents_from({**fit.exponents, OFFSET: 0.5})
    fixed_fit = fit_hypothesis(clock.data, hypothesis, start[None], fit.grid_points)
    return explained_fraction(clock, replace(clock, fit=fixed_fit))


@dataclass(frozen=True)
class OffsetProfile:
    """The likelihood of offsets, with the string's parameters adapted to each.

    Attributes
    ----------
    offsets : numpy.ndarray, shape (U,)
        Offsets relative to the times of the trials [s].
    log_likelihood : numpy.ndarray, shape (U,)
        Log-likelihood, linearised in the fit's other parameters.
    chi : numpy.ndarray, shape (U, P)
        Exponents adapted to each offset.
    """

    offsets: np.ndarray
    log_likelihood: np.ndarray
    chi: np.ndarray


def profile_offset(clock: ClockFit, half_width: float) -> OffsetProfile:
    """Profile the likelihood over offsets in a range around zero [s].

    One batch simulates all offsets with the finite differences of all parameters. A
    Gauss-Newton step then adapts the parameters to each offset.
    """
    fit = clock.fit
    index = clock.index
    model = fit.hypothesis.model
    offsets = np.linspace(-half_width, half_width, PROFILE_SIZE)
    size = len(fit.chi)
    chi = np.repeat(fit.chi[None], PROFILE_SIZE, axis=0)
    chi[:, index] = model.parameters[index].chi(offsets)
    others = np.delete(np.arange(size), index)
    steps = np.zeros((size, size))  # the first row is no step
    signs = np.where(fit.chi[others] > 0.5, -1.0, 1.0)
    steps[np.arange(1, size), others] = signs * solver.MAX_DIFFERENCE
    lanes = (chi[:, None] + steps).reshape(-1, size)
    rows = clock.data.whiten(
        clock.data.residuals(model, lanes), fit.grid_points
    ).reshape(PROFILE_SIZE, size, -1)

    log_likelihood = np.zeros(PROFILE_SIZE)
    from_middle = fit.chi[others] - 0.5
    for number, white in enumerate(rows):
        slopes = (white[1:] - white[0]) / (signs * solver.MAX_DIFFERENCE)[:, None]
        normal = slopes @ slopes.T + PRIOR_PRECISION * np.eye(size - 1)
        gradient = slopes @ white[0] + PRIOR_PRECISION * from_middle
        step = -np.linalg.solve(normal, gradient)
        gain = -0.5 * float(step @ gradient)
        log_likelihood[number] = gain - 0.5 * float(white[0] @ white[0])
        chi[number, others] = np.clip(fit.chi[others] + step, 0.0, 1.0)
    return OffsetProfile(offsets, log_likelihood, chi)


def refit_from(clock: ClockFit, chi: np.ndarray) -> ClockFit:
    """Refit from other exponents (P,); return the better of both fits."""
    fit = clock.fit
    other = fit_hypothesis(clock.data, fit.hypothesis, chi[None], fit.grid_points)
    return better_fit(clock, replace(clock, fit=other))


def shift_observations(
    observations: Sequence[Observation], offsets: Mapping[str, float]
) -> list[Observation]:
    """Return trials with offsets added to the times of their points [s]."""
    shifted = []
    for observation in observations:
        times = observation.points["t"] + offsets[observation.trial]
        points = observation.points.assign(t=times)
        shifted.append(replace(observation, points=points))
    return shifted
