"""Random motions: Eq. 2 of the paper, the arm's limits, and hits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from stringcast.data.schema import DataError
from stringcast.pipeline.settings.typed_settings import bind_stage
from stringcast.stages.generate.curves import Curves, first_curves, next_curves
from stringcast.stages.generate.generate import MotionNotFoundError
from stringcast.stages.model.box import Box
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.model.target import Target

# implicit steps allow large time steps
STRING = String(0.3, integrator=ImplicitLeapfrog(), largest_step=1e-3)
SETTINGS = {
    "attempts": 20000,
    "batch": 256,
    "shortest": 0.2,
    "longest": 1.5,
    "alpha": 150.0,
    "fraction": 0.25,
    "hits": 1,
}
TARGET = Target(0.4, 0.7, 0.02, 0.04)


def generate(*given, seed, **settings):
    """Generate a motion through the stage, with settings as keywords."""
    return bind_stage(
        {"_target_": "stages.generate.generate.generate"} | settings, "generate", "here"
    )(*given, seed=seed)


def test_segments_that_pass_through_a_box_cross_it():
    box = Box(0.0, 0.0, 2.0, 1.0)
    a = np.array(
        [
            [-3.0, 0.0],
            [-3.0, 2.0],
            [0.0, 0.0],
            [1.5, -3.0],
            [0.5, -3.0],
            [-3.0, 0.0],
            [0.9, 0.0],
        ]
    )
    b = np.array(
        [
            [3.0, 0.0],
            [3.0, 2.0],
            [0.1, 0.1],
            [1.5, 3.0],
            [0.5, 3.0],
            [-1.1, 0.0],
            [0.9, 0.0],
        ]
    )
    assert box.is_crossed_by(a, b).tolist() == [
        True,
        False,
        True,
        False,
        True,
        False,
        True,
    ]


def test_angles_are_the_integral_of_bezier_velocity():
    control = np.random.default_rng(0).normal(size=(1, 3, 6))
    control[..., [0, -1]] = 0
    curve = Curves(np.array([[0.1, -0.2, 0.3]]), np.array([0.8]), control)
    angles, speeds = curve.sample(1e-4, 0.9)
    t = np.arange(angles.shape[1]) * 1e-4
    np.testing.assert_allclose(
        angles[0] - [0.1, -0.2, 0.3],
        cumulative_trapezoid(speeds[0], t, axis=0, initial=0),
        atol=1e-6,
    )
    assert np.all(speeds[0, t > 0.8001] == 0)
    middle = control[0] @ np.array([1, 5, 10, 10, 5, 1]) / 32
    np.testing.assert_allclose(speeds[0, 4000], middle, rtol=1e-9)


def test_control_points_follow_equation_2_and_changes_are_bounded(arm):
    rng = np.random.default_rng(1)
    first = first_curves(arm, rng, 500, (0.2, 1.5), 150.0)
    assert np.all(first.control[..., [0, -1]] == 0)
    bound = 150.0 * first.duration[:, None, None] / 5
    assert np.all(np.abs(first.control[..., 1:-1]) <= bound)
    assert np.abs(first.control[..., 1:-1] / bound).max() > 0.99
    assert 0.2 <= first.duration.min() < 0.22
    assert 1.48 < first.duration.max() <= 1.5
    last = first.select(np.array([0]))
    later = next_curves(arm, rng, 500, (0.2, 1.5), 150.0, last, 0.25)
    assert np.all(later.start == last.start)
    assert np.abs(later.duration - last.duration).max() <= 1.3 / 4 + arm.tick
    reach = 0.25 * np.minimum(150.0 * later.duration / 5, 20.66)
    assert np.all(np.abs(later.control - last.control) <= reach[:, None, None] + 1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_motion_hits_in_simulation_within_every_limit(arm, camera, seed):
    """The hit is checked from the commands alone, with another sampling."""
    wall = Box(0.6, 0.35, 0.05, 0.3)  # an obstacle to most motions
    motion = generate(
        Model(STRING, arm, camera),
        TARGET,
        (wall,),
        None,
        None,
        seed=seed,
        **SETTINGS | {"hits": 5},
    )
    commands = motion.commands
    q, w = (
        commands[["q1", "q2", "q3"]].to_numpy(),
        commands[["w1", "w2", "w3"]].to_numpy(),
    )
    assert np.all((q >= arm.lowest) & (q <= arm.highest))
    assert np.all(np.abs(w) <= np.array(arm.speed) * 1.01)
    assert (
        np.linalg.norm(arm.grasp_velocity(q, w)[:, :2], axis=1).max()
        <= arm.hand_speed * 1.01
    )
    joints = arm.joint_positions(q)
    assert not wall.is_crossed_by(joints[:, :-1], joints[:, 1:]).any()
    times = np.arange(0, motion.duration, 0.0007)
    hand = resample_joint_motion(commands["t"].to_numpy(), q).hand_motion(arm)
    points = simulate(STRING, hand, STRING.start_values()[None], times).points[0]
    assert TARGET.is_crossed_by(points[:-1, -1], points[1:, -1]).any()
    assert not wall.is_crossed_by(points[:, :-1], points[:, 1:]).any()
    attempts = motion.attempts.set_index("outcome")["count"]
    assert attempts.sum() == motion.outcome["tried"].iloc[0]
    assert attempts["the arm touches an obstacle"] > 0
    assert attempts["the string touches an obstacle"] > 0


def test_lower_hand_speed_limit_is_kept(arm, camera):
    slow = replace(arm, hand_speed=4.0)
    motion = generate(
        Model(STRING, slow, camera), TARGET, (), None, None, seed=1, **SETTINGS
    )
    q, w = (
        motion.commands[names].to_numpy()
        for names in (["q1", "q2", "q3"], ["w1", "w2", "w3"])
    )
    assert np.linalg.norm(slow.grasp_velocity(q, w)[:, :2], axis=1).max() <= 4.0 * 1.01
    assert motion.attempts.set_index("outcome")["count"]["the hand is too fast"] > 0


def test_hit_with_longest_stay_in_the_box_is_taken(arm, camera):
    def stay(hits, seed):
        motion = generate(
            Model(STRING, arm, camera),
            TARGET,
            (),
            None,
            None,
            seed=seed,
            **SETTINGS | {"hits": hits},
        )
        t = np.arange(0, motion.duration, 0.0005)
        hand = resample_joint_motion(
            motion.commands["t"].to_numpy(),
            motion.commands[["q1", "q2", "q3"]].to_numpy(),
        ).hand_motion(arm)
        tip = simulate(STRING, hand, STRING.start_values()[None], t).tip[0]
        return TARGET.is_crossed_by(tip[:-1], tip[1:]).mean() * motion.duration

    first, best = ([stay(hits, seed) for seed in range(3)] for hits in (1, 6))
    assert all(b >= f - 0.0011 for f, b in zip(first, best, strict=True))
    assert sum(best) > sum(first) + 0.002


def test_new_motions_are_tried_if_no_change_of_the_last_hits(arm, camera):
    """Changes of one part in a million miss this target by 0.5 m."""
    model = Model(STRING, arm, camera)
    last = generate(model, TARGET, (), None, None, seed=0, **SETTINGS)
    stuck = SETTINGS | {"fraction": 1e-6, "attempts": 4096}
    motion = generate(
        model, Target(0.75, 0.3, 0.06, 0.06), (), last, None, seed=0, **stuck
    )
    assert 4096 < motion.outcome["tried"].iloc[0] < 8192
    assert (
        motion.attempts.set_index("outcome")["count"]["the tip misses the target"]
        >= 4096
    )


def test_target_that_no_motion_hits_is_refused_with_the_reason(arm, camera):
    with pytest.raises(DataError, match="out of reach"):
        generate(
            Model(STRING, arm, camera),
            Target(2.0, 0.7, 0.02, 0.04),
            (),
            None,
            None,
            seed=0,
            **SETTINGS,
        )
    with pytest.raises(MotionNotFoundError, match="misses the target"):
        generate(
            Model(STRING, arm, camera),
            Target(0.9, 0.5, 1e-6, 1e-6),
            (),
            None,
            None,
            seed=0,
            **SETTINGS | {"attempts": 64},
        )
