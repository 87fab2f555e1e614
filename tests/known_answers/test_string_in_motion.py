"""The string in motion, against the answers of mechanics."""

import numpy as np
import pytest
from scipy.special import jn_zeros

from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import Integrator, RungeKutta4
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion, resample_hand_motion
from stringcast.stages.model.string import String
from tests.known_answers.swinging import frequency, mechanical_energy, segment_angles

UNDAMPED_VALUES = {
    "axial_stiffness": 9e5,
    "axial_damping": 100.0,
    "bending_stiffness": 1e-9,
    "bending_damping": 1e-12,
    "linear_drag": 1e-12,
    "quadratic_drag": 1e-12,
    "grasp_stiffness": 1e-12,
    "grasp_damping": 1e-12,
}


def sideways_hand_motion(t: np.ndarray, offset: np.ndarray) -> HandMotion:
    """Return the motion of a grasp that points down and moves sideways."""
    return resample_hand_motion(
        t, np.stack([offset, 0 * t, 0 * t - np.pi / 2], axis=-1)
    )


@pytest.mark.parametrize("mode", [1, 2])
def test_a_hanging_chain_swings_at_the_zeros_of_bessels_function(mode):
    """A hanging chain swings at the zeros of Bessel's function.

    omega_k = j_{0,k} / 2 sqrt(g / L). The hand drives the mode and stops, and
    oscillations are counted.
    """
    string = String(0.3, points=60, tip_cell=0.5, grasp_cell=0.5)
    expected = jn_zeros(0, mode)[-1] / 2 * np.sqrt(9.81 / 0.3)
    t = np.arange(0, 8, 0.005)
    drive = 1e-4 * np.sin(expected * t) * (t < 3 * 2 * np.pi / expected)
    x = simulate(
        string, sideways_hand_motion(t, drive), string.values(UNDAMPED_VALUES)[None], t
    ).tip[0, :, 0]
    free = t > 3 * 2 * np.pi / expected + 0.1
    basis = np.stack([x[free] - x[free].mean()])
    assert frequency(t[free], basis[0]) == pytest.approx(
        expected, rel=0.01 if mode == 1 else 0.03
    )


def test_a_rigid_string_on_a_free_hinge_is_a_physical_pendulum():
    """A rigid string on a free hinge is a physical pendulum.

    omega^2 = (3 / 2) g / L for a thin rod.
    """
    string = String(0.3, points=40, tip_cell=0.5)
    stiff = UNDAMPED_VALUES | {"bending_stiffness": 400.0, "bending_damping": 0.05}
    t = np.arange(0, 6, 0.005)
    x = (
        simulate(
            string,
            sideways_hand_motion(t, 1e-3 / (1 + np.exp(-(t - 0.3) / 0.05))),
            string.values(stiff)[None],
            t,
        ).tip[0, :, 0]
        - 1e-3
    )
    assert frequency(t[200:], x[200:]) == pytest.approx(
        np.sqrt(1.5 * 9.81 / 0.3), rel=2e-3
    )


def test_air_brings_a_falling_string_to_terminal_speed():
    """Air brings a falling string to terminal speed.

    (C_c1 + C_c2 v) v = g; the hand falls with it.
    """
    string = String(0.3, points=10)
    c1, c2 = 2.0, 1.5
    speed = (-c1 + np.sqrt(c1**2 + 4 * c2 * 9.81)) / (2 * c2)
    named = UNDAMPED_VALUES | {"linear_drag": c1, "quadratic_drag": c2}
    t = np.arange(0, 3, 0.005)
    fall = np.where(t < 0.5, 0.0, -speed * (t - 0.5))
    hand = resample_hand_motion(t, np.stack([0 * t, fall, 0 * t - np.pi / 2], axis=-1))
    points = simulate(string, hand, string.values(named)[None], t).points[0]
    assert np.ptp((points[-100:, :, 1] - points[-100:, :1, 1]).sum(axis=1)) < 1e-6
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(points[-1], axis=0), axis=1), 0.3 / 9, atol=1e-7
    )


def test_the_hinge_at_the_grasp_stays_continuous_through_full_turns():
    """The hinge at the grasp stays continuous through full turns.

    A hand that turns three times winds up the hinge evenly, also at multiples of pi.
    """
    string = String(0.3, points=10)
    named = UNDAMPED_VALUES | {
        "bending_stiffness": 4.0,
        "bending_damping": 5e-3,
        "grasp_stiffness": 5.0,
        "grasp_damping": 5e-3,
    }
    t = np.arange(0, 1.5, 0.005)
    turned = []
    for turns in (0, 1, -2):
        theta = -np.pi / 2 + 2 * np.pi * turns + 4 * np.pi * t
        pose = np.stack([0 * t, 0 * t, theta], axis=-1)
        turned.append(
            simulate(
                string, resample_hand_motion(t, pose), string.values(named)[None], t
            ).points[0]
        )
    np.testing.assert_allclose(turned[1], turned[0], atol=1e-7)
    np.testing.assert_allclose(turned[2], turned[0], atol=1e-7)
    speed = np.linalg.norm(np.diff(turned[0][:, -1], axis=0), axis=-1) / 0.005
    assert speed.max() < 4 * np.pi * 0.3 * 2.5


@pytest.mark.parametrize(
    ("integrator", "step"), [(RungeKutta4(), 5e-5), (ImplicitLeapfrog(), 1e-4)]
)
def test_energy_is_conserved_without_damping_and_decreases_with_it(
    integrator: Integrator, step: float
):
    string = String(0.3, points=10, integrator=integrator, largest_step=step)
    named = UNDAMPED_VALUES | {
        "axial_stiffness": 2e4,
        "axial_damping": 1e-9,
        "bending_stiffness": 1.0,
        "grasp_stiffness": 1.0,
    }
    t = np.arange(0, 1.0, 0.0005)
    hand = resample_hand_motion(
        t,
        np.stack(
            [0.05 * np.exp(-(((t - 0.1) / 0.03) ** 2)), 0 * t, 0 * t - np.pi / 2], -1
        ),
        5e-4,
    )
    free = t > 0.3

    def energy(named, times):
        points = simulate(string, hand, string.values(named)[None], times).points[0]
        grasp_angle = segment_angles(points)[:, 0] + np.pi / 2
        grasp = 0.5 * named["grasp_stiffness"] * grasp_angle**2
        return grasp + mechanical_energy(points, times, string.segment_length, named)

    kept = energy(named, t)[free]
    # at rest before the motion begins
    moved = kept[0] - energy(named, t[:2] - t[2])[0]
    assert moved > 0.1
    assert np.ptp(kept[5:-5]) < 0.01 * moved
    lossy = named | {"linear_drag": 1.0, "bending_damping": 1e-2, "axial_damping": 10.0}
    lost = energy(lossy, t)[free]
    assert np.all(np.diff(lost[5:-5]) < 1e-4 * moved)


def test_diverging_candidates_are_rejected_and_do_not_affect_others():
    string = String(0.3)
    t = np.arange(0, 0.5, 0.005)
    good = string.values(UNDAMPED_VALUES)
    bad = good.copy()
    bad[string.names.index("axial_stiffness")] = np.nan
    motion = simulate(
        string, sideways_hand_motion(t, 0.01 * t), np.stack([good, bad, good]), t
    )
    assert motion.finite.tolist() == [True, False, True]
    assert np.isnan(motion.points[1]).all()
    np.testing.assert_array_equal(motion.points[0], motion.points[2])


def test_divergence_after_the_last_time_does_not_matter():
    """Only a candidate's own times decide on its rejection.

    Other candidates may be simulated for longer, and diverge later.
    """
    t = np.arange(0, 1.5, 0.005)
    hand, string = (
        sideways_hand_motion(t, np.where(t < 1.0, 0.02 * np.sin(6 * t), 1e5)),
        String(0.3),
    )
    early_times, late_times = np.linspace(0.0, 0.41, 50), np.linspace(0.0, 1.4, 50)
    single_motion = simulate(
        string, hand, string.values(UNDAMPED_VALUES)[None], early_times
    )
    both = simulate(
        string,
        hand,
        np.tile(string.values(UNDAMPED_VALUES), (2, 1)),
        np.stack([early_times, late_times]),
    )
    assert single_motion.finite.all()
    assert list(both.finite) == [True, False]
    np.testing.assert_array_equal(both.points[0], single_motion.points[0])
