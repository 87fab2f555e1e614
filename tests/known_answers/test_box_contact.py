"""A box that the string touches: potential, bounce, rest, friction and energy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stringcast.stages.model.effect import numbered_effect
from stringcast.stages.model.effects.box_contact import BoxContact
from stringcast.stages.model.engine.integrators import RungeKutta4
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.known_answers.swinging import mechanical_energy

BOX = {"centre_x": 0.3, "centre_y": -0.2, "width": 0.06, "height": 0.1}
STIFFNESS = 2e4


def depth(x, y, box=BOX):
    """Return the depth d with 1/d^2 = 1/a^2 + 1/b^2."""
    a = np.maximum(box["width"] / 2 - np.abs(x - box["centre_x"]), 0.0)
    b = np.maximum(box["height"] / 2 - np.abs(y - box["centre_y"]), 0.0)
    return a * b / np.hypot(np.hypot(a, b), 1e-30)


def contact_force(x, y, vx=0.0, vy=0.0, stiffness=STIFFNESS, friction=0.0, loss=0.0):
    place = {name: BOX[name] for name in ("centre_x", "centre_y")}
    sides = BoxContact.derive_parameters(BOX["width"], BOX["height"])
    return np.array(
        BoxContact.load(
            x, y, vx, vy, 0.0, stiffness, **place, friction=friction, loss=loss, **sides
        )
    )


def throw_point(start, end, gravity=0.0, **how):
    """Return a mass point's state (x, y, vx, vy) at the time `end` [s]."""

    def law(_, y):
        return np.concatenate([y[2:], contact_force(*y, **how) + [0.0, -gravity]])

    return solve_ivp(
        law, (0, end), start, method="DOP853", rtol=1e-10, atol=1e-12, max_step=2e-3
    ).y[:, -1]


@pytest.fixture
def inside():
    """Return points anywhere in the box but on its middle lines, (2, M)."""
    rng = np.random.default_rng(0)
    half = np.array([[BOX["width"]], [BOX["height"]]]) / 2
    way = rng.uniform(0.02, 1, (2, 2000)) * rng.choice([-1, 1], (2, 2000))
    return np.array([[BOX["centre_x"]], [BOX["centre_y"]]]) + way * half


def test_the_force_is_the_gradient_of_its_potential_and_points_outwards(inside):
    x, y = inside
    h = 1e-7
    energy = lambda x, y: STIFFNESS / 2 * depth(x, y) ** 2  # noqa: E731
    slope = [energy(x + h, y) - energy(x - h, y), energy(x, y + h) - energy(x, y - h)]
    push = contact_force(x, y)
    np.testing.assert_allclose(
        push, -np.array(slope) / (2 * h), atol=1e-4 * np.abs(push).max()
    )
    assert (push * (inside - [[BOX["centre_x"]], [BOX["centre_y"]]])).min() >= 0
    assert np.abs(contact_force(x + BOX["width"], y)).max() == 0
    assert np.abs(contact_force(x, y + BOX["height"])).max() == 0


def test_the_step_bound_covers_the_stiffness_of_the_contact(inside):
    """The step bound covers the stiffness of the contact.

    The largest eigenvalue of its Jacobian is the stiffness near a side; elsewhere it is
    smaller.
    """
    x, y = inside
    h = 1e-7
    columns = [
        contact_force(x + h, y) - contact_force(x - h, y),
        contact_force(x, y + h) - contact_force(x, y - h),
    ]
    steepest = np.linalg.eigvalsh(-np.array(columns).transpose(2, 0, 1) / (2 * h)).max()
    declared, _ = BoxContact.bound(stiffness=STIFFNESS, friction=0.0, loss=0.0, **BOX)
    assert steepest == pytest.approx(declared, rel=0.01)


PATHS = {
    "top": ((0.31, -0.15, 0.4, -1.5), [1, -1]),
    "bottom": ((0.31, -0.25, 0.4, 1.5), [1, -1]),
    "left": ((0.27, -0.19, 1.5, 0.4), [-1, 1]),
    "right": ((0.33, -0.19, -1.5, 0.4), [-1, 1]),
}


@pytest.mark.parametrize("side", PATHS)
def test_a_bounce_off_a_side_conserves_energy(side):
    """A bounce off a side returns all of its energy.

    The velocity is mirrored, except for the effect of the edge 20 mm away: at 1.5 mm
    depth, the velocity along the side changes by 0.03 m/s.
    """
    start, mirror = PATHS[side]
    end = throw_point(start, 0.01, stiffness=1e6)
    assert depth(*end[:2]) == 0
    assert np.hypot(*end[2:]) == pytest.approx(np.hypot(*start[2:]), rel=1e-7)
    np.testing.assert_allclose(end[2:], np.multiply(start[2:], mirror), atol=0.03)


@pytest.mark.parametrize("side", PATHS)
def test_the_rebound_with_loss_follows_hunt_and_crossley(side):
    """The rebound with loss has the speed of Hunt and Crossley.

    The integral of v dv / (1 - a v) over the depth gives logarithms. Along the side
    nothing is lost.
    """
    start, mirror = PATHS[side]
    across = int(np.argmin(mirror))
    end = throw_point(start, 0.01, stiffness=1e6, loss=0.3)
    left, right = (
        -(np.log1p(-0.3 * v) + 0.3 * v)
        for v in (abs(end[2 + across]), -abs(start[2 + across]))
    )
    assert left == pytest.approx(right, rel=0.02)
    assert end[3 - across] == pytest.approx(start[3 - across], abs=0.03)


def test_the_contact_force_never_pulls(inside):
    """It does not pull at any speed of departure and any loss."""
    outwards = np.sign(inside - [[BOX["centre_x"]], [BOX["centre_y"]]])
    assert (contact_force(*inside, *(20 * outwards), loss=0.5) == 0).all()
    assert (contact_force(*inside, *(-20 * outwards), loss=0.5) * outwards >= 0).all()


@pytest.mark.parametrize("offset", [-0.02, -0.004, 0.0, 0.001, 0.02])
def test_a_bounce_off_an_edge_conserves_energy(offset):
    """A bounce off an edge returns all of its energy.

    Points are thrown at 45 degrees at the upper right edge and next to it.
    """
    start = np.array([0.33 + 0.03 + offset, -0.15 + 0.03 - offset, -1.2, -1.2])
    out = throw_point(start, 0.15)
    assert depth(*out[:2]) == 0
    assert np.hypot(*out[2:]) == pytest.approx(1.2 * np.sqrt(2), rel=1e-7)
    if offset == 0:
        np.testing.assert_allclose(out[2:], [1.2, 1.2], rtol=1e-6)


def test_steps_across_an_edge_keep_energy_to_second_order():
    """Steps across an edge keep energy to second order.

    Semi-implicit steps, as the engine's, move points that are aimed at an edge.

    The force is continuous on their path. With the true distance as the depth, the
    error fell only by 2.0 at each halving, and was 5 times larger at 0.1 ms.
    """
    rng = np.random.default_rng(0)
    beside = rng.uniform(-4e-3, 4e-3, 1000)
    turn = np.pi / 4 + rng.uniform(-0.6, 0.6, 1000)
    speed = 3.0
    way = np.stack([np.cos(turn), np.sin(turn)])
    errors = []
    for step in (1e-4, 5e-5):
        place = np.array([[0.33], [-0.15]]) + np.stack([beside, -beside]) + 0.03 * way
        velocity = -speed * way
        for _ in range(round(0.03 / step)):
            velocity = velocity + step * contact_force(*place, stiffness=1e6)
            place = place + step * velocity
        errors.append(np.sqrt(np.mean(((velocity**2).sum(axis=0) / speed**2 - 1) ** 2)))
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_mass_dropped_on_top_rests_at_the_depth_of_its_weight():
    """A mass dropped on top rests at the depth of its weight.

    The depth is g / k, to a relative error of 2 (depth / half the width)^2 = 0.05 %.
    """
    end = throw_point([0.3, -0.149, 0.0, 0.0], 6.0, gravity=9.81, loss=0.5)
    assert -0.15 - end[1] == pytest.approx(9.81 / STIFFNESS, rel=2e-3)
    assert np.abs(end[2:]).max() < 1e-3


def test_a_sliding_mass_decelerates_by_the_friction_coefficient():
    """A mass that slides on top is slowed by the friction coefficient.

    dv/dt = -mu g, to 1 % at speeds well above the smoothing speed.
    """
    start = [0.28, -0.15 - 9.81 / STIFFNESS, 0.8, 0.0]
    end = throw_point(start, 0.04, gravity=9.81, friction=0.4)
    assert end[1] == pytest.approx(start[1], abs=1e-5)
    assert 0.8 - end[2] == pytest.approx(0.4 * 9.81 * 0.04, rel=0.02)


# --- a string

LENGTH = 0.3
LIMP_VALUES = {
    "axial_stiffness": 2e4,
    "bending_stiffness": 1.0,
    "grasp_stiffness": 1e-12,
    **dict.fromkeys(
        ["axial_damping", "bending_damping", "linear_drag", "quadratic_drag"], 1e-9
    ),
    "grasp_damping": 1e-12,
}


def swing_string(boxes, t, **how):
    """Simulate an undamped string of 10 points, (F, n, 2) [m].

    Its hand moves 0.2 m sideways in 0.25 s and stops. Boxes without a stiffness are
    absent.
    """
    effects = [numbered_effect(BoxContact, i) for i in range(len(boxes))]
    string = String(
        LENGTH,
        effects=(*PAPER_EFFECTS, *effects),
        integrator=RungeKutta4(),
        largest_step=5e-5,
    )
    sizes = {
        f"{e.name}.{k}": v
        for e, box in zip(effects, boxes, strict=True)
        for k, v in (box | how).items()
    }
    along = 0.1 * (1 - np.cos(np.pi * np.clip(t / 0.25, 0, 1)))
    hand = resample_hand_motion(
        t, np.stack([along, 0 * t, 0 * t - np.pi / 2], axis=-1), float(t[1])
    )
    return (
        Model(string, None, None)
        .simulate_string(hand, string.values(LIMP_VALUES | sizes)[None], t)
        .points[0]
    )


def energy_with_contact(points, t, boxes, stiffness):
    """Return the energy over the mass of a point, (F,) [m^2/s^2].

    It is kinetic, potential, elastic, and that of the contact.
    """
    energy = mechanical_energy(points, t, LENGTH / 9, LIMP_VALUES)
    return energy + sum(
        0.5 * stiffness * (depth(*points[:, 1:].T, box) ** 2).sum(axis=0)
        for box in boxes
    )


SWING_TIMES = np.arange(0, 0.8, 1e-4)
UPPER_BOX = {"centre_x": 0.33, "centre_y": -0.14, "width": 0.1, "height": 0.08}
LOWER_BOX = {"centre_x": 0.42, "centre_y": -0.28, "width": 0.1, "height": 0.1}


@pytest.fixture(scope="module")
def free_string():
    """Simulate the string where the boxes are absent."""
    return swing_string([UPPER_BOX, LOWER_BOX], SWING_TIMES)


@pytest.mark.parametrize(
    "how",
    [{}, {"loss": 0.2}, {"friction": 0.3}],
    ids=lambda how: next(iter(how), "neither"),
)
def test_a_string_between_two_boxes_stays_outside_and_gains_no_energy(free_string, how):
    """A string swung between two boxes stays outside and gains no energy.

    Its middle is caught by one box, its tip bounces off the other.

    Points are no deeper than speed over frequency. Without loss the energy is conserved
    to 1.1e-4 m^2/s^2; the boxes store 0.2, and the swing has 10. Velocities are
    differences over 0.1 ms. With loss or friction the energy never rises.
    """
    stiffness, t = 1e5, SWING_TIMES
    boxes = [UPPER_BOX, LOWER_BOX]
    points = swing_string(boxes, t, stiffness=stiffness, **how)
    speed = np.linalg.norm(np.gradient(points, t, axis=0), axis=-1)
    for box in boxes:
        deep = depth(*points.T, box).T
        assert 1e-3 < deep.max() < speed[deep > 0].max() / np.sqrt(stiffness)
        assert depth(*free_string.T, box).max() > 5 * deep.max()
    energy = energy_with_contact(points, t, boxes, stiffness)[(t > 0.26) & (t < 0.795)]
    if how:
        assert energy[0] - energy[-1] > 0.04
        assert (energy - np.minimum.accumulate(energy)).max() < 3e-4
    else:
        np.testing.assert_allclose(energy, energy[0], atol=3e-4)
