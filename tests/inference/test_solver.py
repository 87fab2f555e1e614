"""Damped least squares of many runs in parallel.

It finds the minimum within bounds, in any valley and with any other runs.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.optimize import least_squares

from stringcast.stages.inference.huber import huber_loss, huber_weights
from stringcast.stages.inference.solver import (
    DIVERGED_RESIDUAL,
    distinct_starts,
    fit_least_squares,
    forward_differences,
    minimise_in_box,
)
from stringcast.stages.model.parameter import (
    Parameter,
    parameter_values,
)

TIMES = np.linspace(0.0, 1.0, 40)
RATES = tuple(
    Parameter(name, "1/s", "", 1e-3, 10.0, 0.1) for name in ("first", "second")
)
LEVEL = (*RATES, Parameter("level", "1", "", -1.0, 1.0, 0.0))
TRUTH = np.array([3.0, 0.02])


@dataclass
class Decay:
    """A level that decays by two rates.

    The data determine hardly more than their sum: a valley curved in exponents.
    """

    parameters: tuple[Parameter, ...] = RATES
    truth: np.ndarray = field(default_factory=lambda: TRUTH)
    limit: float = np.inf
    noise: np.ndarray = field(default_factory=lambda: np.zeros(len(TIMES)))
    batches: list[int] = field(default_factory=list)
    candidates_at_once: int = 1

    def seen(self, values):
        first, second, *level = values.T[..., None]
        return np.exp(-(first + second) * TIMES) * (1 + 0.1 * second * TIMES) + (
            level[0] if level else 0.0
        )

    def residuals(self, chi):
        self.batches.append(len(chi))
        return (
            self.seen(parameter_values(self.parameters, chi))
            - self.seen(self.truth[None])
        ) / 1e-3 + self.noise


class Torn(Decay):
    """A decay whose simulation diverges if its first rate is above 5."""

    def residuals(self, chi):
        torn = parameter_values(self.parameters, chi)[:, 0] > 5.0
        return np.where(torn[:, None], DIVERGED_RESIDUAL, super().residuals(chi))


def test_the_minimum_of_a_curved_valley_is_reached_from_all_starts():
    """With as many slopes, SciPy's trust region in exponents does not reach it."""
    starts = np.random.default_rng(0).uniform(0.05, 0.95, (8, 2))
    problem = Decay()
    fits = fit_least_squares(problem, starts, 40)
    assert fits.loss.max() < 1e-3
    np.testing.assert_allclose(
        parameter_values(RATES, fits.chi).sum(axis=1), TRUTH.sum(), rtol=0.01
    )
    theirs = [
        least_squares(
            lambda chi: Decay().residuals(chi[None])[0],
            start,
            bounds=(0, 1),
            x_scale="jac",
            max_nfev=40,
        )
        for start in starts
    ]
    assert sum(2 * each.cost / len(TIMES) > 1e-3 for each in theirs) >= 2


@pytest.mark.parametrize("limit", [np.inf, 2.0])
def test_the_minimum_within_bounds_is_scipys(limit):
    """The minimum within bounds is SciPy's.

    The best level is beyond its range, so that the rates are optimal at its bound. It
    is tested with outliers, and without.
    """
    noise = np.random.default_rng(1).standard_normal(len(TIMES))
    noise[::9] += 30.0
    problem = Decay(LEVEL, np.array([*TRUTH, 1.02]), limit, noise)
    found = fit_least_squares(problem, np.full((1, 3), 0.5), 200, min_gain=1e-12)
    how = {"loss": "linear"} if np.isinf(limit) else {"loss": "huber", "f_scale": limit}
    start = np.array([0.8, 0.3, 0.9])
    theirs = least_squares(
        lambda chi: problem.residuals(chi[None])[0],
        start,
        bounds=(0, 1),
        xtol=1e-15,
        **how,
    )
    assert found.chi[0, 2] == 1.0
    assert (
        0.5 * len(TIMES) * np.log(found.loss[0] * len(TIMES) / 2 / theirs.cost) < 0.05
    )


def test_runs_do_not_depend_on_other_runs():
    starts = np.random.default_rng(2).uniform(0, 1, (5, 2))
    together = fit_least_squares(Decay(), starts, 12).chi
    alone = np.concatenate(
        [fit_least_squares(Decay(), start[None], 12).chi for start in starts]
    )
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_an_iteration_takes_few_batches_and_finished_runs_cost_nothing():
    """Eight runs of two parameters need their residuals and 8 x 2 differences.

    Then they try 8 x 2 steps of least damping, and 8 x 6 other steps if these
    gain too little.
    """
    problem = Decay()
    fit_least_squares(problem, np.full((8, 2), 0.5), 1)
    assert problem.batches == [8, 16, 16]
    problem = Decay()
    fit_least_squares(problem, np.full((8, 2), 0.9), 1)
    assert problem.batches == [8, 16, 16, 48]

    noise = np.random.default_rng(3).standard_normal(len(TIMES))
    optimum = fit_least_squares(Decay(noise=noise), np.full((1, 2), 0.5)).chi[0]
    problem = Decay(noise=noise)
    fit_least_squares(problem, np.stack([optimum, [0.1, 0.1]]), 30)
    assert problem.batches[:2] == [2, 4]
    assert len(problem.batches) > 4
    assert max(problem.batches[2:]) <= 6


def test_the_best_start_in_each_place_is_kept():
    worse, best, far = [0.699, 0.5], [0.7, 0.5], [0.1, 0.5]
    starts = np.array([far, worse, best])
    losses = huber_loss(Decay().residuals(starts), np.inf)
    assert losses[2] < losses[1] < losses[0]
    assert distinct_starts(Decay(), starts).tolist() == [best, far]

    problem = Decay()
    assert distinct_starts(problem, starts[:1]).tolist() == [far]
    assert not problem.batches


def test_a_run_at_its_optimum_costs_only_its_finite_differences():
    noise = np.random.default_rng(3).standard_normal(len(TIMES))
    problem = Decay(noise=noise)
    optimum = fit_least_squares(problem, np.full((1, 2), 0.5)).chi
    problem = Decay(noise=noise)
    again = fit_least_squares(problem, optimum)
    assert problem.batches == [1, 2]
    assert again.chi.tolist() == optimum.tolist()


def test_steps_to_diverged_simulations_are_rejected_and_their_slopes_are_zero():
    edge = RATES[0].chi(5.0)
    chi = np.array([[edge - 1e-5, 0.5]])
    residual = Torn().residuals(chi)
    slope = forward_differences(Torn(), chi, residual, np.full((1, 2), -1e-4))
    assert not slope[0, 0].any()
    assert slope[0, 1, 1:].all()
    fits = fit_least_squares(Torn(), np.array([[edge - 0.01, 0.9]]), 60)
    assert fits.loss[0] < 1e-3


class Blind(Decay):
    """A decay whose third parameter has no effect."""

    def residuals(self, chi):
        return Decay().residuals(chi[:, :2])


def test_a_direction_without_curvature_does_not_move():
    found = fit_least_squares(Blind(LEVEL), np.array([[0.4, 0.6, 0.37]]), 40)
    assert found.loss[0] < 1e-3
    assert found.chi[0, 2] == pytest.approx(0.37, abs=1e-9)


def test_the_minimum_of_a_quadratic_in_a_box_is_that_of_a_grid():
    """The minimum of a quadratic in a box is that of a fine grid.

    A parameter that would leave the box stays on its side; the other is optimal there.
    """
    normal, gradient = np.array([[2.0, 1.2], [1.2, 1.0]]), np.array([-3.0, -0.5])
    low, high = np.array([-1.0, -0.8]), np.array([1.0, 0.8])
    step = minimise_in_box(normal, gradient, low, high)
    grid = np.stack(
        np.meshgrid(*(np.linspace(a, b, 401) for a, b in zip(low, high, strict=True))),
        axis=-1,
    )
    cost = grid @ gradient + 0.5 * np.einsum("...i,ij,...j", grid, normal, grid)
    np.testing.assert_allclose(
        step, grid[np.unravel_index(np.argmin(cost), cost.shape)], atol=0.006
    )


def test_hubers_weights_have_the_slope_of_its_loss():
    size = np.linspace(-6, 6, 25)[:, None]
    slope = (huber_loss(size + 1e-6, 2.0) - huber_loss(size - 1e-6, 2.0)) / 2e-6
    np.testing.assert_allclose(
        slope, (2 * huber_weights(size, 2.0) * size)[:, 0], atol=1e-5
    )
    assert huber_loss(size, np.inf) == pytest.approx(size[:, 0] ** 2)


class NarrowBowl:
    """A bowl narrower than the width of the first differences."""

    parameters = (LEVEL[2],)
    limit = np.inf
    candidates_at_once = 1

    def residuals(self, chi):
        return 1.0 + (1e5 * (chi - 0.50003)) ** 2


def test_a_run_without_an_improving_step_narrows_its_differences():
    """Left of the minimum, the difference over 1e-4 has the wrong sign."""
    start = np.array([[0.5]])
    wide = NarrowBowl().residuals(start + 1e-4) - NarrowBowl().residuals(start)
    assert wide > 0
    found = fit_least_squares(NarrowBowl(), start, 60)
    assert found.loss[0] < 2.0  # 100 at first, 1 at the minimum


@dataclass
class Pit(Decay):
    """A decay whose residuals are larger everywhere except at one point."""

    place: float = 0.0

    def residuals(self, chi):
        smooth = super().residuals(chi)
        is_outside = chi[:, [0]] != self.place
        return smooth + 0.01 * is_outside * np.sign(smooth)


def test_a_run_stops_if_no_step_gains_and_the_predicted_gain_is_small():
    """Slopes around a pit predict a gain of 11, but no step gains anything."""
    noise = np.random.default_rng(3).standard_normal(len(TIMES))
    optimum = fit_least_squares(Decay(noise=noise), np.full((1, 2), 0.5)).chi
    pit = Pit(noise=noise, place=optimum[0, 0])
    fit_least_squares(pit, optimum, 60, min_gain=30.0)
    assert pit.batches == [1, 2, 2, 6]  # start, differences, steps
    wide = Pit(noise=noise, place=optimum[0, 0], candidates_at_once=8)
    fit_least_squares(wide, optimum, 60, min_gain=30.0)
    assert wide.batches == [1, 2, 8]
    eager = Pit(noise=noise, place=optimum[0, 0])
    fit_least_squares(eager, optimum, 60, min_gain=1.0)
    assert len(eager.batches) > 8


def test_fixed_exponents_do_not_move():
    """Fixed parameters are constant, and the others are optimal given them."""
    problem = Decay()
    start = np.array([[0.6, 0.3], [0.7, 0.5]])
    is_fixed = np.array([[True, False], [False, True]])
    runs = fit_least_squares(problem, start, is_fixed=is_fixed)
    assert (runs.chi[is_fixed] == start[is_fixed]).all()
    free = fit_least_squares(problem, start)
    assert (runs.loss > free.loss).all()
    assert (runs.loss < 1e-3 * np.mean(problem.residuals(start) ** 2, axis=1)).all()
