"""Each effect against a known answer.

All are in one model, in which one at a time is present.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import CameraEffect, StringEffect
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.backlash import Backlash
from stringcast.stages.model.effects.box_contact import BoxContact
from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.effects.equal_points import EqualPoints
from stringcast.stages.model.effects.grasp_slip import GraspSlip
from stringcast.stages.model.effects.nonlinear_bending import NonlinearBending
from stringcast.stages.model.effects.resolution import Resolution
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import SemiImplicitEuler
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.hand import MAX_LAG_S, HandMotion, resample_hand_motion
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.model import Model
from stringcast.stages.model.statics.equilibrium import hanging_shape
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.conftest import waving_pose
from tests.known_answers.swinging import frequency, mechanical_energy

LENGTH = 0.3
# all of the library, whose loop ../laws/test_effects.py needs, too
MANY_EFFECTS = tuple(
    e
    for e in effects_by_name().values()
    if e not in PAPER_EFFECTS and e.parameters and issubclass(e, StringEffect)
)
SECOND_ORDER = {"tip_cell": 0.5, "grasp_cell": 0.5}
LIMP_VALUES = {
    "axial_stiffness": 9e5,
    "axial_damping": 100.0,
    **dict.fromkeys(
        ["bending_stiffness", "bending_damping", "linear_drag", "quadratic_drag"], 1e-9
    ),
    **dict.fromkeys(["grasp_stiffness", "grasp_damping"], 1e-12),
}
ROD = LIMP_VALUES | {"bending_stiffness": 4e3, "bending_damping": 0.05}
CLAMPED = LIMP_VALUES | {
    "bending_stiffness": 4e4,
    "grasp_stiffness": 1e9,
    "axial_stiffness": 1e9,
}
# the paper's segment: bending stiffness over mass per length is k_h times its square
PER_LENGTH = LENGTH / 9


def at_rest(named, theta=-np.pi / 2, points=41, **settings):
    """Return angles (n - 1,) and lengths of the segments in static equilibrium."""
    string = String(
        LENGTH,
        points=points,
        effects=(*PAPER_EFFECTS, *MANY_EFFECTS),
        **SECOND_ORDER | settings,
    )
    material = string.material(string.values(named)[None])
    angles, lengths = hanging_shape(string, material, np.array([[0.0, 0.0, theta]]))
    return angles[0], lengths[0]


def swinging(named, offset, t, points=41, theta=-np.pi / 2):
    """Simulate a string whose grasp moves sideways, (F, n, 2) [m].

    The set-up compiles the loop of implicit steps with all effects but boxes.
    """
    effects = [effect for effect in MANY_EFFECTS if effect is not BoxContact]
    string = String(
        LENGTH,
        points=points,
        effects=(*PAPER_EFFECTS, *effects),
        integrator=ImplicitLeapfrog(),
        largest_step=1e-3,
        **SECOND_ORDER,
    )
    hand = resample_hand_motion(t, np.stack([offset, 0 * t, 0 * t + theta], axis=-1))
    return (
        Model(string, None, None)
        .simulate_string(hand, string.values(named)[None], t)
        .points[0]
    )


# --- string


@pytest.mark.parametrize("ratio", [0.05, 0.5])
def test_a_weight_at_the_tip_slows_a_pendulum(ratio):
    """A weight at the tip slows a pendulum.

    omega^2 = g / L (1/2 + m) / (1/3 + m).
    """
    t = np.arange(0, 4, 0.005)
    offset = 1e-3 / (1 + np.exp(-(t - 0.3) / 0.05))
    x = swinging(ROD | {"tip_mass.ratio": ratio}, offset, t, points=21)[:, -1, 0] - 1e-3
    expected = np.sqrt(9.81 / LENGTH * (0.5 + ratio) / (1 / 3 + ratio))
    assert frequency(t[200:], x[200:]) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("taper", [-1.2, 1.2])
def test_a_tapered_chain_swings_at_its_own_frequency(taper):
    """A tapered chain swings at its own frequency.

    (T x')' + omega^2 rho x = 0, with T the weight beyond, is solved by Ritz with
    polynomials that vanish at the grasp.
    """
    powers = np.arange(1, 9)
    rho = lambda z: 1 + taper * (z - 0.5)  # noqa: E731
    weight = lambda z: quad(rho, z, 1)[0]  # noqa: E731
    z, w = np.polynomial.legendre.leggauss(40)
    z, w = (z + 1) / 2, w / 2
    shape, slope = z[:, None] ** powers, powers * z[:, None] ** (powers - 1)
    stiff = slope.T @ ((w * np.array([weight(a) for a in z]))[:, None] * slope)
    mass = shape.T @ ((w * rho(z))[:, None] * shape)
    expected = np.sqrt(eigh(stiff, mass, eigvals_only=True)[0] * 9.81 / LENGTH)
    t = np.arange(0, 6, 0.005)
    drive = 1e-4 * np.sin(expected * t) * (t < 2 * np.pi / expected * 3)
    free = t > 2 * np.pi / expected * 3 + 0.1
    x = swinging(LIMP_VALUES | {"density_taper.taper": taper}, drive, t)[free, -1, 0]
    plain = swinging(LIMP_VALUES, drive, t)[free, -1, 0]
    assert frequency(t[free], x - x.mean()) == pytest.approx(expected, rel=0.01)
    # a string without taper has another frequency
    assert abs(frequency(t[free], plain - plain.mean()) / expected - 1) > 0.03


def test_wind_holds_a_limp_string_at_an_angle():
    """Wind holds a limp string at an angle.

    The tangent of the angle from the vertical is (C_c1 + C_c2 w) w / g.
    """
    wind, c1, c2 = 1.7, 2.0, 0.5
    angles, _ = at_rest(
        LIMP_VALUES | {"linear_drag": c1, "quadratic_drag": c2, "wind.along_x": wind}
    )
    np.testing.assert_allclose(
        np.tan(angles + np.pi / 2), (c1 + c2 * wind) * wind / 9.81, rtol=1e-6
    )


def test_wind_acts_more_across_a_string_than_along_it():
    """Wind acts more across a string than along it.

    Only the drag across holds it: the tangent of the angle is (1 + e) C_c1 w / g.
    """
    named = LIMP_VALUES | {
        "linear_drag": 2.0,
        "wind.along_x": 1.7,
        "anisotropic_drag.excess": 0.8,
    }
    angles, _ = at_rest(named)
    np.testing.assert_allclose(
        np.tan(angles + np.pi / 2), 1.8 * 2.0 * 1.7 / 9.81, rtol=1e-4
    )


@pytest.mark.parametrize("curvature", [3.0, -8.0])
def test_a_stiff_string_with_a_set_rests_on_a_circle(curvature):
    """A stiff string with a rest curvature rests on a circle.

    Half the difference of both signs is free of gravity, which bends it by 2e-4.
    """
    shapes = [
        at_rest(CLAMPED | {"rest_curvature.curvature": sign * curvature}, points=61)[0]
        for sign in (1, -1)
    ]
    middle = (np.arange(60) + 0.5) * LENGTH / 60
    np.testing.assert_allclose(
        (shapes[0] - shapes[1]) / 2, curvature * middle, atol=3e-4 * abs(curvature)
    )


@pytest.mark.parametrize("hardening", [-1e-3, 2e-3])
def test_a_string_that_stiffens_hangs_as_the_elastica_with_its_law(hardening):
    """A string that stiffens hangs as the elastica with its law.

    Clamped level, it has dM/ds = -g (L - s) cos(theta), and kappa'(s) is from the slope
    of the law. A clamped first segment of the chain is a rod clamped at its middle.
    """
    stiffness, first = 30.0 * PER_LENGTH**2, LENGTH / 240

    def law(k):
        return k * (
            stiffness + NonlinearBending.hinge_stiffness(k, stiffness, hardening)
        )

    def slopes(s, y):
        steep = (law(y[1] + 1e-4) - law(y[1] - 1e-4)) / 2e-4
        return np.stack([y[1], 9.81 * (LENGTH - s) * np.cos(y[0]) / steep])

    s = np.linspace(first, LENGTH, 61)
    guess = np.stack([-(1 - np.exp(-s / 0.1)), -10 * (1 - s / LENGTH)])
    exact = solve_bvp(
        slopes, lambda a, b: np.array([a[0], b[1]]), s, guess, tol=1e-8, max_nodes=20000
    )
    assert exact.success
    named = LIMP_VALUES | {
        "bending_stiffness": 30.0,
        "grasp_stiffness": 1e9,
        "axial_stiffness": 1e9,
    }
    angles, _ = at_rest(
        named | {"nonlinear_bending.hardening": hardening},
        theta=0.0,
        points=121,
        grasp_cell=0.0,
    )
    middle = (np.arange(120) + 0.5) * LENGTH / 120
    np.testing.assert_allclose(angles, exact.sol(middle)[0], atol=3e-3)
    linear, _ = at_rest(named, theta=0.0, points=121, grasp_cell=0.0)
    assert np.abs(linear - exact.sol(middle)[0]).max() > 0.03


@pytest.mark.parametrize("hardening", [-5e-3, -3e-4, 5e-3])
def test_softening_bending_moments_never_decrease(hardening):
    """Bending moments never fall, however soft the string becomes.

    A softening moment approaches stiffness / (2 sqrt(-hardening)), and the string does
    not buckle.
    """
    k = np.arange(200.0)
    moment = k * (1 + NonlinearBending.hinge_stiffness(k, 1.0, hardening))
    assert np.diff(moment).min() > 0
    small = np.sqrt(1e-3 / abs(hardening))
    assert NonlinearBending.hinge_stiffness(small, 1.0, hardening) == pytest.approx(
        hardening * small**2, rel=2e-3
    )
    if hardening < 0:
        assert moment.max() < 0.5 / np.sqrt(-hardening)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("nonlinear_bending.hardening", 5e-3),
        ("nonlinear_bending.hardening", -2e-3),
    ],
)
def test_an_implicit_step_handles_a_steep_moment_like_small_explicit_steps(name, value):
    """An implicit step handles a steep moment as small explicit steps do.

    An explicit swing needs 5 to 8 times the steps. Noise is 0.7 mm. The small steps
    have an error of 0.01 mm.
    """
    t = np.arange(0, 1.0, 0.005)
    pose = np.stack(
        [
            0.3 * np.sin(5 * t) ** 2,
            0.2 * np.sin(4 * t) ** 2,
            1.2 * np.sin(6 * t) ** 2 - 1.5,
        ],
        axis=-1,
    )
    hand = resample_hand_motion(t, pose)
    effects = (*PAPER_EFFECTS, NonlinearBending)
    string = String(LENGTH, 21, effects, integrator=ImplicitLeapfrog(), **SECOND_ORDER)
    named = {
        "bending_stiffness": 10.0,
        "bending_damping": 0.01,
        "grasp_stiffness": 4.0,
        "grasp_damping": 5e-3,
    }
    named |= {
        "axial_stiffness": 5e5,
        "axial_damping": 45.0,
        "linear_drag": 0.2,
        "quadratic_drag": 0.2,
    }
    named |= {name: value}
    values = string.values(named)[None]
    # a loop that other tests need, too
    explicit = replace(string, integrator=SemiImplicitEuler())

    def tip(string, step):
        return (
            Model(replace(string, largest_step=step), None, None)
            .simulate_string(hand, string.values(named)[None], t)
            .tip[0]
        )

    assert (
        steps_per_tick(
            replace(string, largest_step=1e-3), string.material(values), hand.tick
        )[0]
        <= 6
    )
    exact = tip(explicit, 1e-5)
    off = [
        np.linalg.norm(tip(string, step) - exact, axis=-1).max()
        for step in (1e-3, 2.5e-4)
    ]
    assert off[0] < 1e-3  # 0.75 mm for beta = 1/4, times 1.3
    assert off[1] < 0.25 * off[0]


def test_tilted_gravity_equals_a_rotated_experiment():
    t = np.arange(0, 0.4, 0.005)
    pose = waving_pose(t, 0.1, 0.3)
    tilt = 0.25
    rotation = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    turned = np.concatenate([pose[:, :2] @ rotation.T, pose[:, 2:] + tilt], axis=1)
    string = String(LENGTH, effects=(*PAPER_EFFECTS, *MANY_EFFECTS))
    named = LIMP_VALUES | {
        "bending_stiffness": 4.0,
        "bending_damping": 5e-3,
        "grasp_stiffness": 3.0,
        "linear_drag": 0.3,
    }

    def simulate_hand(pose, **more):
        values = string.values(named | more)[None]
        return (
            Model(string, None, None)
            .simulate_string(resample_hand_motion(t, pose), values, t)
            .points[0]
        )

    found = simulate_hand(turned, **{"gravity_direction.tilt": tilt})
    np.testing.assert_allclose(found, simulate_hand(pose) @ rotation.T, atol=1e-9)


# --- contact

FLOOR = {"contact.stiffness": 2e4, "contact.height": -0.2}


def test_a_floor_carries_the_part_that_lies_on_it():
    """A floor carries the part of the string that lies on it.

    The floor pushes with the weight of that part. It is all but what still hangs from
    the hand, L - 0.2 to a few per cent.
    """
    angles, lengths = at_rest(
        LIMP_VALUES | FLOOR | {"bending_stiffness": 0.05, "grasp_stiffness": 0.01},
        -1.2,
        points=61,
    )
    y = np.concatenate([[0.0], np.cumsum(lengths * np.sin(angles))])
    cells = np.full(61, LENGTH / 60)
    cells[-1] /= 2
    carried = (2e4 * np.maximum(-0.2 - y, 0) * cells).sum() / 9.81
    assert y.min() > -0.2 - 2e-3
    assert carried == pytest.approx(LENGTH - 0.2, rel=0.1)


def test_a_string_at_rest_on_the_floor_stays_at_rest():
    """A string at rest on the floor stays at rest.

    Statics and dynamics have the same floor.
    """
    t = np.linspace(0, 0.3, 61)
    named = (
        LIMP_VALUES
        | FLOOR
        | {
            "bending_stiffness": 1.0,
            "bending_damping": 0.01,
            "grasp_stiffness": 1.0,
            "linear_drag": 1.0,
        }
    )
    named |= {"contact.friction": 0.3, "contact.loss": 0.2}
    points = swinging(named, 0 * t, t, points=21, theta=-1.2)
    assert points[..., 1].min() < -0.2
    assert np.abs(points - points[:1]).max() < 1e-8


@pytest.mark.parametrize(("loss", "tilt"), [(0.0, 0.0), (0.3, 0.0), (0.0, 1.1)])
def test_a_bounce_never_gains_energy(loss, tilt):
    """A bounce returns the energy it took, and never more.

    A mass on the plane leaves without loss as fast as it came. With loss it is slower,
    as Hunt and Crossley say.
    """
    normal = np.array([-np.sin(tilt), np.cos(tilt)])
    given = {"dt": 0.0, "stiffness": 2e4, "height": 0.1, "friction": 0.0, "loss": loss}
    given |= Contact.derive_parameters(tilt=tilt)

    def law(_, y):
        return np.concatenate([y[2:], Contact.load(*y, **given)])

    along = np.array([normal[1], -normal[0]])
    speed = 2.0
    start = np.concatenate([0.1 * normal, -speed * normal + 0.7 * along])
    end = solve_ivp(law, (0, 0.05), start, rtol=1e-10, atol=1e-12).y[:, -1]
    out = end[2:] @ normal
    assert end[2:] @ along == pytest.approx(0.7, abs=1e-9)
    if loss == 0:
        assert out == pytest.approx(speed, rel=1e-8)
    else:
        # m dv/dt = -k d (1 - loss v)...: v dv / (1 - a v) over depth integrates to log
        # terms
        left, right = (-(np.log1p(-loss * v) + loss * v) for v in (out, -speed))
        assert left == pytest.approx(right, rel=1e-6)
        assert 0.5 * speed < out < speed


@pytest.mark.parametrize(("dt", "within"), [(1e-3, 0.5), (1e-4, 0.1), (1e-5, 0.1)])
def test_friction_brakes_a_hard_impact_and_reverses_no_slide(dt, within):
    """Friction brakes a hard impact by its share, and reverses no slide.

    At any step a mass loses the friction coefficient times 20 m/s, the impulse of the
    plane, or all its speed.
    """
    given = {
        "dt": dt,
        "stiffness": 1e5,
        "height": 0.0,
        "friction": 0.5,
        "loss": 0.0,
    } | Contact.derive_parameters(tilt=0.0)
    for slide, left in ((14.0, 4.0), (1.0, 0.0)):
        place, velocity, slides = np.zeros(2), np.array([slide, -10.0]), []
        while place[1] <= 0:
            velocity = velocity + dt * np.array(
                Contact.load(*place, *velocity, **given)
            )
            place = place + dt * velocity
            slides.append(velocity[0])
        assert velocity[1] == pytest.approx(10.0, rel=0.02)
        assert min(slides) >= 0
        assert np.diff(slides).max() <= 0
        assert slides[-1] == pytest.approx(left, abs=within)


def test_a_string_dropped_on_a_floor_gains_no_energy():
    """A string dropped on a floor gains no energy.

    The engine's own steps are taken while the hand is lowered. Height, speed, bending
    and floor together never rise again.
    """
    t = np.arange(0, 1.0, 0.001)
    string = String(LENGTH, effects=(*PAPER_EFFECTS, *MANY_EFFECTS), points=10)
    named = LIMP_VALUES | {
        "axial_stiffness": 2e4,
        "axial_damping": 5.0,
        "bending_stiffness": 1.0,
        "bending_damping": 1e-2,
    }
    named |= {
        "contact.stiffness": 2e4,
        "contact.height": -0.32,
        "contact.friction": 0.3,
        "contact.loss": 0.1,
    }
    down = -0.15 * (1 - np.cos(np.pi * np.clip(t / 0.2, 0, 1))) / 2
    hand = resample_hand_motion(t, np.stack([0 * t, down, 0 * t - 1.4], axis=-1), 0.001)
    points = (
        Model(string, None, None)
        .simulate_string(hand, string.values(named)[None], t)
        .points[0]
    )
    energy = mechanical_energy(points, t, string.segment_length, named)
    energy += 0.5 * 2e4 * (np.maximum(-0.32 - points[..., 1], 0) ** 2).sum(axis=1)
    free = energy[t > 0.21]
    assert points[..., 1].min() < -0.32
    assert free[0] - free[-1] > 0.1
    assert np.diff(free[5:-5:5]).max() < 0.01 * (free[0] - free[-1])


# --- hand

T = np.arange(0, 1.0, 0.005)
WAVES = np.stack(
    [np.sin(7 * T) ** 2, 0.5 * np.sin(4 * T), 0.2 * np.cos(11 * T)], axis=-1
)[None]


@pytest.mark.parametrize("constant", [1e-3, 0.02, 0.1])
def test_lag_solves_the_first_order_differential_equation(constant):
    spline = CubicSpline(T, WAVES[0], bc_type="natural")
    exact = solve_ivp(
        lambda t, y: (spline(t) - y) / constant,
        (0, T[-1]),
        WAVES[0, 0],
        t_eval=T,
        method="Radau",
        rtol=1e-9,
        atol=1e-11,
    )
    found = ArmLag.joints(T, WAVES, np.full((1, 1, 1), constant))[0]
    np.testing.assert_allclose(found, exact.y.T, atol=1e-7)


def test_a_ramp_is_followed_with_a_constant_lag():
    """A ramp is followed at a distance.

    The distance u - y is v tau (1 - exp(-t / tau)), for two candidates together.
    """
    ramp = np.maximum(T - 0.1, 0)[None, :, None] * np.ones(3) * 2.0
    real = ArmLag.joints(T, ramp, np.array([0.01, 0.05])[:, None, None])
    behind = ramp[:, -1, 0] - real[:, -1, 0]
    np.testing.assert_allclose(behind, 2.0 * np.array([0.01, 0.05]), rtol=1e-3)


def test_a_lagging_hand_arrives_during_rest():
    """A hand that lags arrives while it rests.

    After the last sample of its log, its distance from the goal decays as exp(-t /
    tau). The log is extended no longer than needed.
    """
    pose = np.stack([0.3 * T**2, 0 * T, 0 * T], axis=-1)
    motion = resample_hand_motion(T, pose)
    acts = [(ArmLag, {"time_constant": np.full((1, 1, 1), 0.02)})]
    goal = pose[-1, 0]
    left = goal - np.array(
        [
            motion.extended_until(T[-1] + more)
            .actual_hand_motion(None, acts)
            .pose[0, -1, 0]
            for more in (0.0, 0.02, 0.04)
        ]
    )
    assert left[1:] / left[:-1] == pytest.approx(np.exp(-1), rel=0.02)
    assert motion.extended_until(0.5).end == motion.end
    assert motion.extended_until(60.0).end == pytest.approx(motion.end + MAX_LAG_S)


def test_a_joint_with_play_rests_at_reversals():
    """Play leaves a joint where it is at reversals.

    It turns half its gap less to either side, and rests over a whole gap after each
    reversal.
    """
    wave, gaps = 0.2 * np.sin(2 * np.pi * T), (0.06, 0.0, 0.02)
    joints = Backlash.joints(
        T, np.tile(wave[None, :, None], 3), *(np.full((1, 1, 1), gap) for gap in gaps)
    )
    for gap, real in zip(gaps, joints[0].T, strict=True):
        assert real.max() == pytest.approx(0.2 - gap / 2, abs=1e-12)
        assert real.min() == pytest.approx(-0.2 + gap / 2, abs=1e-12)
        still = (T > 0.25) & (wave > 0.2 - gap) & (T < 0.5)
        np.testing.assert_allclose(real[still], 0.2 - gap / 2, atol=1e-12)
        assert np.abs(real - wave).max() <= gap / 2 + 1e-12


def hand_model(*names, points=10):
    return Model(String(LENGTH, points=points), None, None).with_effects(
        *(effects_by_name()[name] for name in names)
    )


def actual_grasp_motion(motion: HandMotion, **named) -> HandMotion:
    model = hand_model(*{name.split(".")[0]: None for name in named})
    return model.hand_motion(motion, model.values(named)[None])


POSE = np.stack(
    [0.4 + 0.1 * np.sin(9 * T), 0.3 * np.cos(5 * T), 1.5 * np.sin(7 * T) ** 2], axis=-1
)


def test_a_string_leaves_the_hand_at_the_grasp_angle():
    plain = resample_hand_motion(T, POSE)
    found = actual_grasp_motion(plain, **{"grasp_angle.angle": 0.4})
    np.testing.assert_allclose(
        found.pose - plain.pose,
        np.broadcast_to([0, 0, 0.4], plain.pose.shape),
        atol=1e-12,
    )
    np.testing.assert_allclose(found.rate, plain.rate, atol=1e-9)


def test_a_slipping_string_moves_along_the_grasp():
    plain = resample_hand_motion(T, POSE)
    found = actual_grasp_motion(
        plain,
        **{
            "grasp_slip.speed": 0.1,
            "grasp_slip.onset": 0.3,
            "grasp_slip.duration": 0.4,
        },
    )
    out = np.sum(
        (found.pose - plain.pose)[0, :, :2]
        * np.stack([np.cos(POSE[:, 2]), np.sin(POSE[:, 2])], -1),
        axis=-1,
    )
    sliding = (T > 0.35) & (T < 0.65)
    np.testing.assert_allclose(out[sliding], 0.1 * (T[sliding] - 0.3), atol=1e-6)
    np.testing.assert_allclose(out[T < 0.2], 0.0, atol=1e-6)
    np.testing.assert_allclose(out[T > 0.8], 0.04, atol=1e-6)
    real = found.rate[0, sliding] - plain.rate[0, sliding]
    direction = np.stack([np.cos(POSE[sliding, 2]), np.sin(POSE[sliding, 2])], -1)
    np.testing.assert_allclose(np.sum(real[:, :2] * direction, axis=-1), 0.1, atol=1e-3)
    assert GraspSlip.parameters[0].start == 0.0


def test_a_gain_scales_turns_from_the_first_angle(arm, camera):
    from stringcast.stages.model.hand import resample_joint_motion

    model = Model(String(LENGTH), arm, camera).with_effects(
        effects_by_name()["joint_gain"]
    )
    plain = resample_joint_motion(T, WAVES[0])
    found = model.joint_motion(plain, model.values({"joint_gain.gain": 0.1})[None])
    np.testing.assert_allclose(
        found.angles - plain.angles[:, :1],
        1.1 * (plain.angles - plain.angles[:, :1]),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        found.speeds[:, 3:-3], 1.1 * plain.speeds[:, 3:-3], atol=2e-4
    )


def test_effects_on_joints_need_joint_angles():
    from stringcast.data.schema import DataError

    with pytest.raises(
        DataError, match=r"'backlash' acts on joint angles.*Add arm.parquet"
    ):
        actual_grasp_motion(resample_hand_motion(T, POSE), **{"backlash.gap_1": 0.01})


# --- clocks and camera

VIEW = Camera(640, 480, 300.0, (250.0, 380.0), 200.0)


def views(*names):
    model = Model(String(LENGTH), None, VIEW).with_effects(
        *(effects_by_name()[name] for name in names)
    )
    known = LIMP_VALUES | {
        "bending_stiffness": 4.0,
        "bending_damping": 5e-3,
        "grasp_stiffness": 3.0,
        "linear_drag": 0.3,
    }
    return model, known, resample_hand_motion(T, POSE)


@pytest.mark.parametrize(
    ("name", "size", "arm_clock"),
    [
        ("time_offset.offset", 0.0123, lambda t: t + 0.0123),
        ("clock_drift.rate", -0.02, lambda t: 0.98 * t),
    ],
)
def test_clock_effects_shift_the_times_of_the_string(name, size, arm_clock):
    """Other clocks show the string at other moments.

    Each candidate has its own times and does not depend on others.
    """
    model, known, motion = views(name.split(".")[0])
    t = np.linspace(0.05, 0.9, 23)
    values = np.stack([model.values(known), model.values(known | {name: size})])
    seen = model.simulate_observation(motion, values, t).points
    np.testing.assert_allclose(
        seen[0], model.simulate_string(motion, values[:1], t).points[0], atol=1e-12
    )
    np.testing.assert_allclose(
        seen[1],
        model.simulate_string(motion, values[:1], arm_clock(t)).points[0],
        atol=1e-12,
    )
    np.testing.assert_array_equal(
        seen[1], model.simulate_observation(motion, values[1:], t).points[0]
    )


ACTUAL_CAMERAS = {
    "lens_distortion.radial": replace(VIEW, distortion=0.08),
    "pixel_scale.excess": replace(VIEW, px_per_m=VIEW.px_per_m * 1.08),
}


@pytest.mark.parametrize("name", ACTUAL_CAMERAS)
def test_camera_effects_transform_points_as_defined(name):
    """Cameras that differ from their description are modelled.

    Pixels of the real camera are read with the described one.
    """
    model, known, motion = views(name.split(".")[0])
    t = np.linspace(0, 0.9, 7)
    values = model.values(known | {name: 0.08})[None]
    expected = VIEW.world(
        ACTUAL_CAMERAS[name].pixels(model.simulate_string(motion, values, t).points)
    )
    np.testing.assert_allclose(
        model.simulate_observation(motion, values, t).points, expected, atol=1e-12
    )


def test_a_rolled_camera_rotates_the_picture_about_its_centre():
    model, known, motion = views("camera_rotation")
    t = np.linspace(0, 0.9, 7)
    values = model.values(known | {"camera_rotation.angle": 0.1})[None]
    true, seen = (
        VIEW.pixels(find(motion, values, t).points) - [319.5, 239.5]
        for find in (model.simulate_string, model.simulate_observation)
    )
    # v points down, so this is counter-clockwise to the eye
    c, s = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose(seen, true @ np.array([[c, -s], [s, c]]), atol=1e-9)


def test_a_rolling_shutter_shears_a_line_that_moves_sideways():
    """A rolling shutter shears a line that moves sideways.

    Each point is reported at its position when its row is exposed, also if it crosses
    rows.
    """
    law = effects_by_name()["rolling_shutter"].observe
    readout, stamped = np.full((1, 1, 1, 1), 0.01), np.full((1, 1, 1, 1), 0.25)
    line = np.stack([0 * np.linspace(0, 1, 9), np.linspace(-0.2, 0.8, 9)], axis=-1)[
        None, None
    ]
    sideways = law(
        line,
        np.broadcast_to([3.0, 0.0], line.shape),
        np.zeros(1),
        VIEW,
        readout,
        stamped,
    )
    row = VIEW.pixels(line)[..., 1] / 480 - 0.25
    np.testing.assert_allclose(sideways[..., 0], 3.0 * 0.01 * row, atol=1e-12)
    falling = law(
        line,
        np.broadcast_to([1.0, -4.0], line.shape),
        np.zeros(1),
        VIEW,
        readout,
        stamped,
    )
    exposure_times = 0.01 * (VIEW.pixels(falling)[..., 1:] / 480 - 0.25)
    np.testing.assert_allclose(
        falling, line + exposure_times * np.array([1.0, -4.0]), atol=1e-12
    )


def test_the_rolling_shutter_uses_the_velocity_of_the_string():
    """The camera accounts for the speed of the string.

    A rolling shutter shows the string at the moments of its rows, to second order in
    the readout.
    """
    model, known, motion = views("rolling_shutter")
    t = np.linspace(0.1, 0.9, 9)
    errors = []
    for readout in (0.002, 0.001):
        values = model.values(known | {"rolling_shutter.readout": readout})[None]
        seen = model.simulate_observation(motion, values, t).points[0]
        exposure_times = t[:, None] + readout * (VIEW.pixels(seen)[..., 1] / 480 - 0.5)
        exact = np.stack(
            [
                model.simulate_string(motion, values, exposure_times[:, i]).points[
                    0, :, i
                ]
                for i in range(10)
            ],
            axis=1,
        )
        errors.append(np.abs(seen - exact).max())
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


CAMERA_EFFECTS = {
    name: effect
    for name, effect in effects_by_name().items()
    if issubclass(effect, CameraEffect)
}


@pytest.mark.parametrize("name", CAMERA_EFFECTS)
def test_velocity_is_simulated_only_if_observed_points_depend_on_it(name, monkeypatch):
    effect = CAMERA_EFFECTS[name]
    model, known, motion = views(name)
    high = {f"{name}.{p.name}": p.high for p in effect.parameters}
    t = np.linspace(0.1, 0.9, 9)
    seen = {}
    for uses_velocity in (True, False):
        monkeypatch.setattr(effect, "uses_velocity", uses_velocity)
        values = model.values(known | high)[None]
        seen[uses_velocity] = model.simulate_observation(motion, values, t).points
    monkeypatch.undo()
    assert np.array_equal(seen[True], seen[False]) is not effect.uses_velocity


def test_more_mass_points_reduce_the_error():
    coarse, known, motion = views()
    t = np.linspace(0, 0.9, 31)

    def tip(model):
        return model.simulate_string(motion, model.values(known)[None], t).tip[0]

    finer = coarse.with_effects(Resolution, Resolution)
    assert finer.string.points == 37
    steps = [tip(coarse), tip(coarse.with_effects(Resolution)), tip(finer)]
    near, far = np.abs(steps[1] - steps[2]).mean(), np.abs(steps[0] - steps[2]).mean()
    assert near < 0.6 * far


def test_the_last_of_equal_points_has_half_a_segment_too_much():
    """The last of equal points has half a segment too much mass.

    A chain of Eq. 1 equals one with half a point at its end plus the excess in mass and
    drag.
    """
    equal, known, motion = views()
    half = replace(equal, string=replace(equal.string, tip_cell=0.5)).with_effects(
        *MANY_EFFECTS
    )
    t, excess = np.linspace(0, 0.9, 31), 0.5 / (equal.string.points - 1)
    tip = equal.simulate_string(motion, equal.values(known)[None], t).tip
    same = half.simulate_string(
        motion, half.values(known | {"equal_points.excess": excess})[None], t
    ).tip
    np.testing.assert_allclose(same, tip, atol=1e-9)
    assert (
        np.abs(
            half.simulate_string(motion, half.values(known)[None], t).tip - tip
        ).max()
        > 1e-3
    )
    assert f"about {equal.string.points} equal" in EqualPoints.describe(
        {"excess": excess}
    )
