"""The mesh chosen for a tolerance keeps it and is no finer than needed."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.known import experiment_for_call
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.model.engine.accuracy import (
    ToleranceError,
    find_converged_string,
    remaining_error,
)
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.string import String
from tests.conftest import TRUTH

STRING_A = TRUTH | {"grasp_stiffness": 3.0}


def test_power_law_errors_are_estimated_exactly():
    step = 0.1 * 0.5 ** np.arange(3)
    for order in (1.0, 1.5, 2.0):
        result = 7.0 + 3.0 * step**order
        left = remaining_error(result[0] - result[1], result[1] - result[2], 2)
        assert left == pytest.approx(3.0 * step[1] ** order, rel=1e-9)
    # Convergence faster than the method's order is not trusted. Errors that do not
    # shrink have no bound. Equal results have no error.
    assert remaining_error(np.array(16.0), np.array(1.0), 2) == pytest.approx(4 / 3)
    assert remaining_error(np.array(1.0), np.array(1.0), 2) == np.inf
    assert remaining_error(np.array(np.inf), np.array(np.inf), 2) == np.inf
    assert remaining_error(np.array(0.0), np.array(0.0), 2) == 0.0


@pytest.fixture(scope="module")
def fast_cast(arm):
    cast = plain_cast(arm, 0.5)
    hand = JointMotion(0.0, arm.tick, *cast.sample(arm.tick, 0.5)).hand_motion(arm)
    times = hand.start + hand.tick * np.arange(hand.pose.shape[1])
    string = String(0.3, tip_cell=0.5, grasp_cell=0.5, integrator=ImplicitLeapfrog())
    values = string.values(STRING_A)
    fine = replace(string, points=113, largest_step=5e-5)
    return hand, string, values, times, simulate(fine, hand, values, times).tip


def test_the_error_of_the_tip_is_below_a_millimetre_only_on_the_fine_mesh(
    fast_cast,
):
    """In a plain cast the rms error is 0.2 mm on the fine mesh, 25 mm on the paper's."""
    hand, _, values, times, exact = fast_cast
    fine, paper = (
        np.sqrt(
            np.mean(
                np.sum(
                    (simulate(string, hand, values, times).tip - exact) ** 2, axis=-1
                )
            )
        )
        for string in (
            experiment_for_call((f"string={name}",), None).string
            for name in ("fine", "paper")
        )
    )
    assert fine < 1e-3 < paper


@pytest.mark.parametrize("tolerance", [0.01, 0.003, 0.001])
def test_the_tip_is_within_the_tolerance_of_a_converged_string(fast_cast, tolerance):
    """The chosen mesh keeps the tolerance, and half as many points do not.

    Errors of 0.5 to 0.9 of the tolerance were measured.
    """
    hand, string, values, times, exact = fast_cast
    found = find_converged_string(string, hand, values, tolerance)

    def tip_error(string: String) -> float:
        return np.linalg.norm(
            simulate(string, hand, values, times).tip - exact, axis=-1
        ).max()

    assert tip_error(found.string) < tolerance
    assert tip_error(found.string) == pytest.approx(
        found.point_error_m + found.step_error_m, rel=0.5
    )
    assert (
        tip_error(replace(found.string, points=(found.string.points + 1) // 2))
        > tolerance
    )


def test_an_impossible_tolerance_is_refused_with_measured_errors(fast_cast):
    hand, string, values, _, _ = fast_cast
    with pytest.raises(ToleranceError, match="the best measured is"):
        find_converged_string(string, hand, values, 1e-5)


def test_a_plain_cast_is_within_the_arms_limits(arm):
    angles, speeds = plain_cast(arm, 0.5).sample(arm.tick, 0.5)
    sweep = (np.asarray(arm.highest) - arm.lowest) / 3
    np.testing.assert_allclose(angles[0, -1] - angles[0, 0], sweep, rtol=1e-9)
    assert (angles >= arm.lowest).all()
    assert (angles <= arm.highest).all()
    assert (
        np.linalg.norm(arm.grasp_velocity(angles, speeds)[..., :2], axis=-1).max()
        < arm.hand_speed
    )
