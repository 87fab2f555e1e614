"""Fits, evidence and covariance of problems that are solved by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from stringcast.stages.inference import covariance, discrepancy_grid, laplace, solver
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.parametrised import Parametrised
from stringcast.stages.model.string import String

TipMass, CameraRotation = find_effects(["tip_mass", "camera_rotation"])
GRID_POINTS = len(discrepancy_grid.log_grid_prior())
UNIT = Parameter("a", "1", "", low=0.0, high=1.0, start=0.0)
FAR = Parameter("b", "1", "", low=0.0, high=4.0, start=1.0)


class LinearData:
    """Two trials whose residuals are linear in three exponents.

    In each, one grid point of the discrepancy is likely; residuals are scaled by it.
    """

    likely = np.array([2, 5])
    candidates_at_once = 1

    def __init__(self):
        rng = np.random.default_rng(0)
        self.slopes = [rng.standard_normal((3, 4)), rng.standard_normal((3, 6))]
        self.offsets = [rng.standard_normal(4), rng.standard_normal(6)]

    def for_hypothesis(self, hypothesis):
        return self

    def residuals(self, model, chi):
        pairs = zip(self.slopes, self.offsets, strict=True)
        return [chi @ slope + offset for slope, offset in pairs]

    def whiten(self, residuals, grid_points):
        pairs = zip(residuals, grid_points, strict=True)
        return np.concatenate([rows / index for rows, index in pairs], axis=1)

    def log_likelihood_by_grid_point(self, residuals):
        found = np.full((2, len(residuals[0]), GRID_POINTS), -1e6)
        for k, index in enumerate(self.likely):
            found[k, :, index] = -0.5 * np.sum((residuals[k] / index) ** 2, axis=1)
        return found

    def overall_tip_rms(self, displacements):
        """Compute it from the last two numbers, in millimetres."""
        squares = [np.sum(rows[:, -2:] ** 2, axis=1) for rows in displacements]
        return 1e-3 * np.sqrt(np.mean(squares, axis=0))


def hypothesis_of(amplitude):
    """Return a hypothesis with one cause, whose amplitude is the second parameter."""
    return SimpleNamespace(
        model=None,
        causes=("cause",),
        parameters=(UNIT, amplitude, UNIT),
        base_indices=[0, 2],
        all_amplitude_indices=[1],
        amplitude_indices=lambda cause: [1],
        exponents_from=lambda known: np.array([0.0, 0.25, 0.0]),
    )


@pytest.mark.parametrize("chi", [[0.3, 0.6, 0.9], [0.3, 0.1, 0.9]])
def test_the_evidence_is_likelihood_times_prior_times_volume(chi):
    data = LinearData()
    chi = np.array(chi)
    fit = laplace.evaluate_fit(data, hypothesis_of(FAR), chi)
    assert list(fit.grid_points) == [2, 5]
    prior = discrepancy_grid.log_grid_prior()
    by_trial = []
    curvature = np.diag([12.0, 1e-9, 12.0])
    squares = []
    for k, index in enumerate(data.likely):
        residual = chi @ data.slopes[k] + data.offsets[k]
        assert fit.residuals[k] == pytest.approx(residual)
        assert fit.slopes[k] == pytest.approx(data.slopes[k])
        by_trial.append(-0.5 * np.sum((residual / index) ** 2) + prior[index])
        curvature += data.slopes[k] @ data.slopes[k].T / index**2
        squares.append(np.sum(data.slopes[k][1, -2:] ** 2))
    assert fit.log_likelihood_by_trial == pytest.approx(by_trial)

    shift_per_exponent = 1e-3 * np.sqrt(np.mean(squares))
    widths = np.array([1e-3, 3e-3, 1e-2, 3e-2])
    shift = abs(chi[1] - 0.25) * shift_per_exponent
    normal = np.exp(-0.5 * (shift / widths) ** 2) / np.sqrt(2 * np.pi) / widths
    log_prior = np.log(np.mean(normal) * shift_per_exponent)
    # A tenth of the 3 above the start is the typical distance from it
    distance = 4 * (chi[1] - 0.25)
    log_prior -= np.log(1 + (distance / 0.3) ** 2)
    volume = 1.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(curvature)[1]
    assert fit.log_evidence == pytest.approx(sum(by_trial) + log_prior + volume)


@pytest.mark.parametrize(
    ("gradient", "gain"),
    [
        ((0.0, 0.0), 0.0),
        ((-1.0, 0.0), 0.125),  # g^2 / 2 H
        ((-1.0, -2.0), 0.125 + 1.0),
        ((1.0, -2.0), 1.0),  # the first exponent is at its bound
        ((0.0, -6.0), 5.0),  # the second reaches a bound
    ],
)
def test_the_predicted_gain_of_a_step_is_the_fall_of_a_quadratic_within_bounds(
    gradient, gain
):
    curvature = np.diag([4.0, 2.0])
    predicted = solver.predicted_gain(curvature, np.array(gradient), np.zeros(2))
    assert predicted == pytest.approx(gain)


def test_the_error_of_the_evidence_is_the_gain_to_the_best_exponents():
    data = LinearData()
    hypothesis = hypothesis_of(FAR)
    rows = [
        slope.T / index for slope, index in zip(data.slopes, data.likely, strict=True)
    ]
    offsets = [-o / index for o, index in zip(data.offsets, data.likely, strict=True)]
    prior = (
        np.sqrt(12.0) * np.eye(3)[[0, 2]]
    )  # prior centred in the middle, except for the amplitude
    matrix = np.vstack([*rows, prior])
    target = np.concatenate([*offsets, prior.sum(axis=1) / 2])
    best = lsq_linear(matrix, target, bounds=(0.0, 1.0))

    chi = np.array([0.3, 0.6, 0.9])
    gain = 0.5 * np.sum((matrix @ chi - target) ** 2) - best.cost
    fit = laplace.evaluate_fit(data, hypothesis, chi)
    assert fit.log_evidence_error == pytest.approx(gain, rel=1e-6)
    assert laplace.evaluate_fit(data, hypothesis, best.x).log_evidence_error < 1e-6


class ScaledData(LinearData):
    """The same trials, with normal discrepancies of any scale of at least 1."""

    def log_likelihood_by_grid_point(self, residuals):
        scales = 1.0 + np.arange(GRID_POINTS)
        found = []
        for rows in residuals:
            squares = np.sum(rows**2, axis=1)[:, None]
            found.append(-0.5 * squares / scales**2 - rows.shape[1] * np.log(scales))
        return np.stack(found)

    def whiten_by_trial(self, residuals, grid_points):
        pairs = zip(residuals, grid_points, strict=True)
        return [rows / (1.0 + index) for rows, index in pairs]


@pytest.mark.parametrize("size", [0.2, 3.0, 20.0])
def test_a_fit_maximises_the_likelihood_of_exponents_and_grid_points(size):
    """No other grid points and exponents gain more than 0.01 in log-likelihood."""
    data = ScaledData()
    data.offsets = [size * offset for offset in data.offsets]
    hypothesis = hypothesis_of(UNIT)
    hypothesis.model = SimpleNamespace(parameters=hypothesis.parameters)

    def negative_log_likelihood(chi):
        by_scale = data.log_likelihood_by_grid_point(data.residuals(None, chi[None]))
        prior = 0.5 * 12.0 * np.sum((chi[[0, 2]] - 0.5) ** 2)
        return prior - by_scale[:, 0].max(axis=1).sum()

    bounds = [(0.0, 1.0)] * 3
    lowest = min(
        minimize(negative_log_likelihood, start, bounds=bounds, method="L-BFGS-B").fun
        for start in np.random.default_rng(2).uniform(size=(8, 3))
    )
    starts = np.random.default_rng(1).uniform(size=(3, 3))
    first = np.array([GRID_POINTS - 1, 0])
    chi, width = laplace.best_exponents(data, hypothesis, starts, first, 1e-6)
    assert negative_log_likelihood(chi) == pytest.approx(lowest, abs=0.01)
    assert ((width >= 1e-6) & (width <= 1e-3)).all()


class RecordedData(ScaledData):
    """The same trials; they record the exponents at which they were simulated."""

    def __init__(self):
        super().__init__()
        self.simulated = set()

    def residuals(self, model, chi):
        self.simulated |= {row.tobytes() for row in chi}
        return super().residuals(model, chi)


def test_a_fit_to_its_end_has_differences_that_were_simulated():
    """A fit that begins there finds them among the kept points (`kept_points`)."""
    data = RecordedData()
    hypothesis = hypothesis_of(UNIT)
    hypothesis.model = SimpleNamespace(parameters=hypothesis.parameters)
    start = np.array([[0.3, 0.6, 0.9]])
    first = np.array([GRID_POINTS - 1, 0])
    chi, width = laplace.best_exponents(data, hypothesis, start, first, 1e-3)
    differences, _ = solver.difference_exponents(chi, width)
    assert {row.tobytes() for row in differences} <= data.simulated

    by_grid_point = data.log_likelihood_by_grid_point(data.residuals(None, chi[None]))
    last = discrepancy_grid.most_likely_grid_point(by_grid_point[:, 0])
    data.simulated.clear()
    laplace.best_exponents(data, hypothesis, chi[None], last, 1e-3, width)
    assert data.simulated == {row.tobytes() for row in differences}


def curved(start):
    """Return residuals 2 + 4e3 x + 1e7 x^2 of the distance x from a start, (C, 1)."""

    def residuals(chi):
        x = chi - start
        return 2 + 4e3 * x + 1e7 * x**2

    return residuals


@pytest.mark.parametrize(("start", "offset"), [(0.1, 2e-5), (0.9, -2e-5)])
def test_finite_differences_step_into_the_range(start, offset):
    residuals = curved(start)
    calls = []

    def simulate(model, chi):
        calls.append(float(chi[1, 0]) - start)
        return [residuals(chi)]

    slopes, others = laplace._residual_slopes(
        SimpleNamespace(residuals=simulate),
        None,
        np.array([start]),
        np.array([2e-5]),
        np.array([[start + 0.01]]),
    )
    assert calls == pytest.approx([offset])
    assert slopes[0] == pytest.approx(np.array([[4e3 + 1e7 * offset]]))
    assert others[0] == pytest.approx(np.array([[2 + 40 + 1000]]))


@pytest.mark.parametrize("limit", [np.inf, 1.0])
def test_a_covariance_is_of_slopes_over_a_tenth_of_the_residual(limit):
    """Residuals are 2, with a slope of 5,000. Their loss is 4, or Huber's 3."""
    residuals = curved(0.1)
    calls = []

    def count(chi):
        calls.append(float(chi[0, 0]) - 0.1)
        return np.repeat(residuals(chi), 3, axis=1)

    times = np.array([0.01, 0.06, 0.07])
    likelihood = SimpleNamespace(
        residuals=count,
        limit=limit,
        data=SimpleNamespace(trials=[SimpleNamespace(point_times=times)]),
    )
    linear = covariance.linearise(likelihood, np.array([0.1]))
    width = 0.1 * np.sqrt(4.0 if limit == np.inf else 3.0) / 5e3
    assert calls == pytest.approx([0.0, 1e-4, width], abs=1e-12)
    assert linear.step == pytest.approx([width])
    assert linear.slope == pytest.approx(np.full((1, 3), 4e3 + 1e7 * width))
    assert linear.residual == pytest.approx(np.full(3, 2.0))
    assert linear.weight == pytest.approx(np.full(3, 1.0 if limit == np.inf else 0.5))
    assert list(linear.block) == [0, 0, 1, 1, 1, 1]


def test_a_jackknife_leaves_out_each_block_in_turn():
    """Compare with regressions without each block; blocks are interleaved."""
    rng = np.random.default_rng(2)
    block = rng.permutation(np.repeat([4, 0, 7, 9, 2], [8, 12, 10, 6, 14]))
    design = 100 * rng.standard_normal((50, 2))
    measured = rng.standard_normal(50)
    weight = rng.uniform(0.5, 1.0, 50)

    def regress(kept):
        root = np.sqrt(weight[kept])
        return np.linalg.lstsq(
            root[:, None] * design[kept], root * measured[kept], rcond=None
        )[0]

    best = regress(np.ones(50, dtype=bool))
    others = np.array([regress(block != number) for number in np.unique(block)])
    away = others - others.mean(axis=0)
    found = covariance.jackknife_covariance(
        design.T, design @ best - measured, weight, block
    )
    assert found.block_count == 5
    assert found.matrix == pytest.approx(0.8 * away.T @ away, rel=1e-3)


def test_the_covariance_includes_the_prior():
    """Each block has a curvature of 2, and the prior one of 12."""
    found = covariance.jackknife_covariance(
        np.ones((1, 4)), np.array([1.0, 1, -1, -1]), np.ones(4), np.array([0, 0, 1, 1])
    )
    assert found.matrix[0, 0] == pytest.approx((2 / 14) ** 2 + 12 / 16**2)


def test_a_fit_gives_exponents_and_values_by_name():
    mass = Parameter("tip_mass.mass", "1", "", low=1.0, high=100.0, start=1.0)
    own = SimpleNamespace(name="mass")
    cause = SimpleNamespace(
        parameters=(own,), qualified_name=lambda parameter: "tip_mass." + parameter.name
    )

    class TwoParameters(Parametrised):
        parameters = (UNIT, mass)

    hypothesis = SimpleNamespace(model=TwoParameters())

    def fit(last):
        residuals = [np.zeros(3), np.array([0.0, last])]
        chi = np.array([0.25, 0.5])
        return laplace.Fit(hypothesis, chi, residuals, [], None, None, None, 0.0)

    found = fit(1.0)
    assert found.exponents == {"a": 0.25, "tip_mass.mass": 0.5}
    assert found.values == pytest.approx({"a": 0.25, "tip_mass.mass": 10.0})
    assert found.cause_parameters(cause) == pytest.approx({"mass": 10.0})
    assert not found.has_diverged
    assert fit(DIVERGED_RESIDUAL).has_diverged


def test_parameters_of_a_hypothesis_are_found_among_those_of_its_model(arm, camera):
    base = Model(String(0.3), arm, camera)
    both = Hypothesis(base, (CameraRotation, TipMass))
    names = both.model.names
    assert [names[i] for i in both.base_indices] == list(base.names)
    for cause in (CameraRotation, TipMass):
        found = [names[i] for i in both.amplitude_indices(cause)]
        assert found
        assert all(name.startswith(cause.name) for name in found)
    absent = both.exponents_from({})
    named = dict(zip(names, both.parameters, strict=True))
    for name, chi in zip(names, absent, strict=True):
        assert chi == pytest.approx(float(named[name].chi(named[name].start)))
    known = both.exponents_from({names[1]: 0.77})
    assert known[1] == 0.77
    assert list(np.delete(known, 1)) == list(np.delete(absent, 1))


def test_a_partly_diverged_trial_is_diverged():
    rows = np.array([[1.0, 2.0], [3.0, DIVERGED_RESIDUAL]])
    calls = []

    def whiten(residuals, grid_points):
        calls.append(list(grid_points))
        return [residual / 10 for residual in residuals]

    data = SimpleNamespace(
        residuals=lambda model, chi: [rows, rows[:, :1]],
        whiten_by_trial=whiten,
        trials=[SimpleNamespace(error_model=SimpleNamespace(scale=s)) for s in (2, 3)],
    )
    likelihood = Likelihood(data, None)
    first, second = likelihood.residuals_by_trial(None)
    assert first.tolist() == [[0.1, 0.2], [DIVERGED_RESIDUAL, DIVERGED_RESIDUAL]]
    assert second == pytest.approx(np.array([[0.1], [0.3]]))
    Likelihood(data, None, np.array([4, 5])).residuals_by_trial(None)
    assert calls == [[0, 0], [4, 5]]
    assert likelihood.noise_scales == (2, 3)


EXPONENTIAL = Parameter("e", "1", "", low=1e-2, high=1.0, start=0.1)


@pytest.mark.parametrize(
    ("chi", "gradient"), [(0.5, 1.0), (0.5, -1.0), (0.1, 1.0), (0.9, -50.0)]
)
def test_trial_steps_are_damped_in_exponents_and_values_and_stay_within_bounds(
    chi, gradient
):
    """One parameter from 0.01 to 1, with a curvature of 4."""
    runs = SimpleNamespace(
        chi=np.array([[chi]]),
        is_fixed=np.array([[False]]),
        normal=np.array([[[4.0]]]),
        gradient=np.array([[gradient]]),
        damping=np.array([0.5]),
    )
    found = solver._trial_points([EXPONENTIAL], runs, 0).ravel()
    value = 0.01 * 100**chi
    slope = np.log(100) * value
    ends = [0.01 * 100 ** np.clip(chi + side * 0.5, 0, 1) for side in (-1, 1)]
    expected = []
    for factor in (1e-3, 0.1, 1.0, 10.0):
        step = -gradient / (4.0 * (1 + 0.5 * factor))
        expected.append(np.clip(chi + np.clip(step, -0.3, 0.3), 0, 1))
    for factor in (1e-3, 0.1, 1.0, 10.0):
        step = -gradient / (4.0 * (1 + 0.5 * factor))
        moved = np.clip(value + slope * step, *ends)
        expected.append(np.clip(np.log(moved / 0.01) / np.log(100), 0, 1))
    assert found == pytest.approx(expected)


def test_trial_steps_are_limited_by_bounds_and_longest_steps(monkeypatch):
    boxes = []

    def record(normal, gradient, low, high):
        boxes.append((low.tolist(), high.tolist()))
        return low

    monkeypatch.setattr(solver, "minimise_in_box", record)
    runs = SimpleNamespace(
        chi=np.array([[0.1, 0.9, 0.5]]),
        is_fixed=np.array([[False, False, True]]),
        normal=np.eye(3)[None],
        gradient=np.zeros((1, 3)),
        damping=np.ones(1),
    )
    solver._trial_points([UNIT] * 3, runs, 0)
    in_exponents, in_values = np.array(boxes[:2])
    assert in_exponents == pytest.approx(np.array([[-0.1, -0.3, 0], [0.3, 0.1, 0]]))
    assert in_values == pytest.approx(np.array([[-0.1, -0.5, 0], [0.5, 0.1, 0]]))


class Line:
    """Four residuals chi @ slopes - measured with two parameters."""

    parameters = (UNIT, UNIT)
    limit = np.inf
    slopes = np.array([[1.0, 2.0, 0.0, 1.0], [0.0, 1.0, 3.0, -1.0]])
    measured = np.array([0.5, 1.5, 1.0, 0.2])

    def residuals(self, chi):
        return chi @ self.slopes - self.measured


@pytest.mark.parametrize("limit", [np.inf, 0.4])
def test_curvature_and_gradient_are_those_of_half_the_loss(limit):
    problem = Line()
    problem.limit = limit
    chi = np.array([[0.2, 0.3], [0.6, 0.5]])
    runs = solver.SolverRuns.start(problem, chi)
    solver._linearise_runs(problem, runs, np.array([1]))
    assert runs.stale.tolist() == [True, False]
    residual = problem.residuals(chi)[1]
    weight = np.minimum(1.0, limit / np.abs(residual))
    curvature = (problem.slopes * weight) @ problem.slopes.T / 4
    assert runs.normal[1] == pytest.approx(curvature)
    assert runs.gradient[1] == pytest.approx(problem.slopes @ (weight * residual) / 4)
    assert not runs.normal[0].any()
    slope_rms = np.sqrt(np.mean(problem.slopes**2, axis=1))
    width = 0.1 * np.sqrt(runs.loss[1]) / slope_rms
    assert runs.width[1] == pytest.approx(np.clip(width, 1e-6, 1e-3))
    assert runs.width[0] == pytest.approx([1e-4, 1e-4])


def test_difference_widths_move_points_by_a_tenth_of_the_residual_within_limits():
    slope = np.array([[[3.0, 4.0], [3e3, 4e3], [0.0, 0.0], [3e6, 4e6]]])
    rms = np.sqrt(12.5)
    found = solver.difference_widths(slope, np.array([0.25]))
    assert found == pytest.approx(np.array([[1e-3, 0.05 / (1e3 * rms), 1e-3, 1e-6]]))
    assert solver.difference_widths(slope, np.zeros(1))[0, 2] == 1e-6


def fake_step(
    monkeypatch, losses, damping=0.5, min_gain=0.05, predicted_share=0.9, is_slow=False
):
    """Step a run with ten residuals, loss 1, and given losses of eight trial steps."""
    points = np.arange(8.0)[:, None]
    problem = SimpleNamespace(
        parameters=(UNIT,),
        limit=np.inf,
        candidates_at_once=1,
        residuals=lambda chi: np.repeat(np.sqrt(losses[chi.astype(int)]), 10, axis=1),
    )
    monkeypatch.setattr(solver, "_trial_points", lambda *given: points)
    runs = solver.SolverRuns.start(problem, np.zeros((1, 1)))
    runs.chi[:] = 9.0
    runs.residual[:] = 1.0
    runs.loss[:] = 1.0
    runs.damping[:] = damping
    runs.stale[:] = False
    runs.is_slow[:] = is_slow
    runs.is_narrow[:] = True
    runs.predicted_share[:] = predicted_share
    solver._step_runs(problem, runs, np.array([0]), min_gain)
    return runs


@pytest.mark.parametrize(
    ("best", "damping"),
    [(0, 5e-4), (1, 0.05), (2, 0.5), (3, 5.0), (4, 5e-4), (7, 5.0)],
)
def test_a_run_takes_the_best_of_its_steps(monkeypatch, best, damping):
    losses = np.full(8, 0.8)
    losses[best] = 0.5
    runs = fake_step(monkeypatch, losses)
    assert runs.chi[0, 0] == best
    assert runs.loss[0] == pytest.approx(0.5)
    assert runs.residual[0] == pytest.approx(np.full(10, np.sqrt(0.5)))
    assert runs.damping[0] == pytest.approx(damping)
    assert runs.stale[0]
    assert runs.active[0]


def test_a_step_that_gains_what_slopes_predict_needs_no_further_trial_step(monkeypatch):
    """The predicted gain is 0.5, the gain 0.41 or 0.39; more damping would gain 0.9."""
    for least_damped in (0, 4):
        losses = np.full(8, 0.1)
        losses[[0, 4]] = 0.7
        losses[least_damped] = 0.59
        runs = fake_step(monkeypatch, losses, predicted_share=0.5)
        assert runs.chi[0, 0] == least_damped
        losses[least_damped] = 0.61
        runs = fake_step(monkeypatch, losses, predicted_share=0.5)
        assert runs.loss[0] == pytest.approx(0.1)


def test_a_run_stops_if_it_gains_too_little_or_no_damping_helps(monkeypatch):
    """Ten residuals gain 5 ln(loss before / after) in log-likelihood."""
    large, small = np.full(8, np.exp(-0.0102)), np.full(8, np.exp(-0.0098))
    assert fake_step(monkeypatch, large, predicted_share=0.0099).active[0]
    assert not fake_step(monkeypatch, small, predicted_share=0.0099).active[0]
    assert fake_step(monkeypatch, np.zeros(8), min_gain=3000).active[0]
    assert not fake_step(monkeypatch, np.zeros(8), min_gain=4000).active[0]
    for losses in (np.ones(8), np.full(8, 2.0)):
        runs = fake_step(monkeypatch, losses)
        assert runs.chi[0, 0] == 9.0
        assert runs.loss[0] == 1.0
        assert runs.damping[0] == pytest.approx(500.0)
        assert not runs.stale[0]
        assert runs.active[0]
    assert not fake_step(monkeypatch, np.ones(8), damping=11.0).active[0]
    assert fake_step(monkeypatch, np.zeros(8), 1e-6).damping[0] == pytest.approx(1e-8)


def test_a_run_with_a_large_predicted_gain_stops_at_its_second_slow_step(monkeypatch):
    large, small = np.full(8, np.exp(-0.0102)), np.full(8, np.exp(-0.0098))
    runs = fake_step(monkeypatch, small)
    assert runs.active[0]
    assert runs.is_slow[0]
    assert not fake_step(monkeypatch, small, is_slow=True).active[0]
    runs = fake_step(monkeypatch, large, is_slow=True)
    assert runs.active[0]
    assert not runs.is_slow[0]


@pytest.mark.parametrize("seed", range(6))
def test_at_the_minimum_in_a_box_the_descent_points_outwards(seed):
    """Karush-Kuhn-Tucker: zero where free, outwards at a bound."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((5, 5))
    normal = root @ root.T + 0.1 * np.eye(5)
    gradient = 3 * rng.standard_normal(5)
    low, high = -rng.uniform(0, 1, 5), rng.uniform(0, 1, 5)
    low[0] = 0.0
    step = solver.minimise_in_box(normal, gradient, low, high)
    slope = gradient + normal @ step
    for k in range(5):
        if step[k] == pytest.approx(low[k], abs=1e-12):
            assert slope[k] > -1e-9
        elif step[k] == pytest.approx(high[k], abs=1e-12):
            assert slope[k] < 1e-9
        else:
            assert low[k] < step[k] < high[k]
            assert slope[k] == pytest.approx(0.0, abs=1e-9)
