"""Symmetries of all forces: translation, rotation, reflection and other candidates."""

import numba
import numpy as np
import pytest
from conftest import TRUTH, threads, waving_pose

from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip
from stringcast.stages.model.engine import batching
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.laws.weightless import WEIGHTLESS_WITH_MEMORY

T = np.arange(0, 0.4, 0.005)
POSE = waving_pose(T, 0.1, 0.3)
BASE_VALUES = TRUTH | {"axial_stiffness": 2e5, "grasp_stiffness": 3.0}
AIRLESS = {"linear_drag": 0.0, "quadratic_drag": 0.0}
STRING = String(0.3)
# its memory is absent by its values
WEIGHTLESS = String(0.3, effects=WEIGHTLESS_WITH_MEMORY, integrator=ImplicitLeapfrog())


def simulate_hand(pose: np.ndarray, string: String = STRING) -> np.ndarray:
    return simulate(
        string, resample_hand_motion(T, pose), string.values(BASE_VALUES)[None], T
    ).points[0]


def test_translation_of_the_experiment_translates_the_string():
    np.testing.assert_allclose(
        simulate_hand(POSE + [0.3, -0.2, 0.0]) - [0.3, -0.2],
        simulate_hand(POSE),
        atol=1e-9,
    )


def test_a_mirrored_motion_gives_a_mirrored_string():
    mirrored = POSE * [-1, 1, -1] + [0, 0, np.pi]
    np.testing.assert_allclose(
        simulate_hand(mirrored) * [-1, 1], simulate_hand(POSE), atol=1e-9
    )


@pytest.mark.parametrize("turn", [0.7, 2.5, -2.0])
def test_rotation_of_a_weightless_experiment_rotates_the_string(turn):
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    turned = np.concatenate([POSE[:, :2] @ rotation.T, POSE[:, 2:] + turn], axis=1)
    expected = simulate_hand(POSE, WEIGHTLESS) @ rotation.T
    # at rest a weightless string points where the grasp does, so both start alike
    np.testing.assert_allclose(simulate_hand(turned, WEIGHTLESS), expected, atol=1e-8)


def test_inner_forces_sum_to_zero():
    """Inner forces do not accelerate the string as a whole.

    Without weight and air, the hand pulls a string. It ends up straight and moves at
    the hand's speed.
    """
    string = WEIGHTLESS
    t = np.arange(0, 0.8, 0.005)
    x = np.cumsum(np.clip((t - 0.05) / 0.1, 0, 1)) * 0.005
    pose = np.stack([x, 0 * t, 0 * t + np.pi], axis=-1)
    named = (
        BASE_VALUES
        | AIRLESS
        | {"axial_damping": 3000.0, "bending_damping": 0.3, "grasp_damping": 0.3}
    )
    points = simulate(
        string, resample_hand_motion(t, pose), string.values(named)[None], t
    ).points[0]
    straight = np.stack(
        [x[:, None] - string.arc_lengths(), np.zeros((len(t), 10))], axis=-1
    )
    assert np.abs(points - straight).max() > 1e-4  # the pull at the start stretched it
    np.testing.assert_allclose(points[-20:], straight[-20:], atol=1e-7)


def test_a_string_that_turns_with_the_hand_is_not_bent_by_the_grasp():
    """A string that turns with the hand is not bent by the grasp.

    Without weight and air, it turns about the grasp at a constant rate, in the
    direction of the grasp.
    """
    string = WEIGHTLESS
    t = np.arange(0, 1.5, 0.005)
    theta = np.cumsum(np.clip(t / 0.2, 0, 1)) * 0.005 * 8
    pose = np.stack([0 * t, 0 * t, theta], axis=-1)
    firm = {
        "bending_stiffness": 400.0,
        "grasp_stiffness": 900.0,
        "bending_damping": 10.0,
        "grasp_damping": 20.0,
    }
    named = BASE_VALUES | AIRLESS | firm
    points = simulate(
        string, resample_hand_motion(t, pose), string.values(named)[None], t
    ).points[0, -1]
    along = points @ [np.cos(theta[-1]), np.sin(theta[-1])]
    across = points @ [-np.sin(theta[-1]), np.cos(theta[-1])]
    assert along[-1] > 0.3
    np.testing.assert_allclose(across, 0, atol=1e-5)


@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), ImplicitLeapfrog()])
def test_results_depend_neither_on_other_candidates_nor_on_threads(integrator):
    string = String(0.3, integrator=integrator)
    rng = np.random.default_rng(1)
    values = np.array([p.value(rng.random(40)) for p in string.parameters]).T
    hand = resample_hand_motion(T, POSE)
    with threads(numba.config.NUMBA_NUM_THREADS):
        joint_result = simulate(string, hand, values, T).points
    with threads(1):
        single_results = np.concatenate(
            [simulate(string, hand, values[i : i + 1], T).points for i in range(40)]
        )
    np.testing.assert_array_equal(joint_result, single_results)


@pytest.mark.parametrize(
    ("integrator", "effects", "lanes"),
    [
        (ImplicitLeapfrog(), (), 1),
        (ImplicitLeapfrog(), (), 8),
        (ImplicitLeapfrog(), (MaxwellSlip,), 8),
        pytest.param(SemiImplicitEuler(), (), 1, marks=pytest.mark.long),
        pytest.param(SemiImplicitEuler(), (), 8, marks=pytest.mark.long),
        pytest.param(RungeKutta4(), (), 1, marks=pytest.mark.long),
        pytest.param(RungeKutta4(), (), 8, marks=pytest.mark.long),
    ],
)
def test_loops_of_fewer_lanes_give_the_same_to_the_bit(
    monkeypatch, integrator, effects, lanes
):
    """A loop of fewer lanes equals the widest to the bit.

    It is compiled after a thousand runs. A result must not depend on the number of
    runs.
    """
    string = String(
        0.3, points=15, integrator=integrator, effects=(*PAPER_EFFECTS, *effects)
    )
    rng = np.random.default_rng(1)
    each = [p.value(rng.uniform(0.3, 0.6, 3)) for p in string.parameters]
    hand, values = resample_hand_motion(T, POSE), np.array(each).T

    def simulate_in_lanes(count: int) -> np.ndarray:
        monkeypatch.setattr(batching, "lane_count", lambda *arguments: count)
        return simulate(string, hand, values, T).points

    widest = simulate_in_lanes(batching.LANES)
    assert np.isfinite(widest).all()
    np.testing.assert_array_equal(simulate_in_lanes(lanes), widest)


def test_few_candidates_run_in_fewer_lanes_once_that_pays(monkeypatch):
    """Few candidates run in eight lanes, a single one with paper's forces in one.

    With other effects the compiler rounds some sums differently in one lane.
    """

    def lanes_of(candidates: int, string: String) -> int:
        loop = (string.effects, string.row_names, string.integrator)
        return batching.lane_count(candidates, *loop)

    monkeypatch.setattr(batching, "RUNS_BEFORE_NARROW_LOOP", 0)
    assert [lanes_of(n, STRING) for n in (1, 2, 8, 9, 16)] == [1, 8, 8, 16, 16]
    assert [lanes_of(n, STRING) for n in (17, 24, 25)] == [8, 8, 16]
    slipping = String(0.3, effects=(*PAPER_EFFECTS, MaxwellSlip))
    assert lanes_of(1, slipping) == 8
    monkeypatch.setattr(batching, "RUNS_BEFORE_NARROW_LOOP", np.inf)
    assert lanes_of(1, STRING) == batching.LANES
