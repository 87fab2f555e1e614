"""Laws with memory: by hand, on any path, and in a string of any integrator."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary, swing
from hypothesis import given, settings
from hypothesis import strategies as st

from stringcast.data.artifacts import JOINTS
from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import RungeKutta4, SemiImplicitEuler
from stringcast.stages.model.engine.law_slots import MEMORY_SLOTS, select_arguments
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.engine.stability import memory_stiffness_bounds
from stringcast.stages.model.hand import HandMotion, resample_joint_motion
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.state import StringState
from stringcast.stages.model.statics.equilibrium import hanging_shape

CAP, SLIP = 0.05, 0.04  # [m3/s2] and [1/m] of a cable
PARAMETER_VALUES = {
    "maxwell_slip": {"cap": CAP, "slip": SLIP},
    "dahl_friction": {"cap": CAP, "slip": SLIP},
    "standard_linear_solid": {"stiffness": CAP / SLIP, "relaxation": 0.1},
    "grasp_play": {"cap": CAP, "slip": SLIP},
}
STATES = {state: moment for state, moment, _ in MEMORY_SLOTS.values()}
MEMORY_LAWS = [
    e
    for e in effects_by_name().values()
    if issubclass(e, StringEffect) and STATES.keys() & e.laws().keys()
]
FINE_PATH = np.concatenate(
    [
        np.linspace(0, 1, 2001),
        np.linspace(1, -1, 4001)[1:],
        np.linspace(-1, 1, 4001)[1:],
    ]
)


def moments(name, path, duration=1e-3, **values):
    """Return the moments along a path of curvatures or angles.

    It begins straight; each step takes the time `duration`.
    """
    laws, held, found = effects_by_name()[name].laws(), 0.0, []
    state, moment = next(
        (state, moment) for state, moment in STATES.items() if state in laws
    )
    parameters = {**PARAMETER_VALUES[name], **values}
    parameters |= effects_by_name()[name].derive_parameters(**parameters)
    for change in np.diff(path, prepend=0.0):
        held = laws[state](
            **select_arguments(
                laws[state],
                {"memory": held, "change": change, "dt": duration, **parameters},
            )
        )
        found.append(
            laws[moment](
                **select_arguments(laws[moment], {"memory": held, **parameters})
            )
        )
    return np.array(found)


def work(path, moment):
    """Return the work done on the hinge until each step.

    The moment holds over the change that made it.
    """
    return np.cumsum(moment * np.diff(path, prepend=0.0))


def test_every_law_with_memory_is_tested_here():
    assert {e.name for e in MEMORY_LAWS} == set(PARAMETER_VALUES)


@pytest.mark.parametrize("name", PARAMETER_VALUES)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_path_extracts_energy_from_a_hinge(name, seed):
    """No path gets more energy out of a hinge than it put in.

    Its moment is zero at first, so all work done on it is stored or dissipated.
    """
    rng = np.random.default_rng(seed)
    path = np.cumsum(SLIP * rng.normal(size=300) * rng.choice([0.02, 0.3, 2.0]))
    work_done = work(path, moments(name, path))
    assert work_done.min() >= -1e-12 * np.abs(work_done).max()


@pytest.mark.parametrize("name", ["maxwell_slip", "grasp_play"])
@pytest.mark.parametrize("wide", [2.0, 5.0])
def test_a_slip_loop_has_the_area_of_its_parallelogram(wide, name):
    path = wide * SLIP * FINE_PATH
    work_done = work(path, moments(name, path))
    loop_start = len(FINE_PATH) - 8000  # the virgin curve is not part of the loop
    assert work_done[-1] - work_done[loop_start - 1] == pytest.approx(
        4 * CAP * (wide - 1) * SLIP, rel=2e-3
    )


def test_a_reversed_slip_follows_masings_rule():
    """A slip turns back on its virgin curve twice as large (Masing's rule)."""
    x = SLIP * np.linspace(0, 1.5, 301)
    virgin = moments("maxwell_slip", x)
    back = moments(
        "maxwell_slip",
        np.concatenate([SLIP * np.linspace(0, 3, 301), SLIP * 3 - 2 * x[1:]]),
    )[300:]
    np.testing.assert_allclose(back[0] - back, 2 * virgin, atol=1e-12)


def test_a_path_within_the_slip_dissipates_nothing():
    path = 0.9 * SLIP * FINE_PATH
    np.testing.assert_allclose(
        moments("maxwell_slip", path), CAP / SLIP * path, atol=1e-12
    )


def test_dahls_friction_approaches_its_cap_exponentially():
    path = SLIP * np.linspace(0, 5, 501)
    expected = CAP * (1 - np.exp(-path / SLIP))
    np.testing.assert_allclose(
        moments("dahl_friction", path), expected, atol=1e-6 * CAP
    )
    np.testing.assert_allclose(
        moments("dahl_friction", path[::100]), expected[::100], atol=3e-3 * CAP
    )


def test_dry_friction_does_not_depend_on_the_rate():
    path = 2 * SLIP * np.sin(np.linspace(0, 7, 200))
    for name in ("maxwell_slip", "dahl_friction", "grasp_play"):
        np.testing.assert_array_equal(
            moments(name, path, 1e-3), moments(name, path, 1.0)
        )


@pytest.mark.parametrize("steps", [50, 100])
def test_relaxation_is_exponential_to_second_order(steps):
    path = np.concatenate([[0.0], np.full(steps, 1.0)])
    found = moments("standard_linear_solid", path, 0.2 / steps)
    faded = found[-1] / found[1]
    expected = np.exp(-(0.2 - 0.2 / steps) / 0.1)
    assert abs(faded - expected) < 2 * expected / 12 * (2.0 / steps) ** 2


# --- memory in a string


@pytest.fixture(scope="module")
def motion():
    commands = swing(0.4).commands
    return resample_joint_motion(
        commands["t"].to_numpy(), commands[list(JOINTS)].to_numpy()
    )


def tip(model, motion, values, integrator, step):
    string = replace(model.string, integrator=integrator, largest_step=step)
    model = replace(model, string=string)
    times = motion.start + motion.tick * np.arange(80)
    return model.simulate_string(
        motion, model.values(TRUTH | values)[None], times
    ).points[0, :, -1]


MILD_VALUES = {
    "maxwell_slip": {"cap": 6e-3, "slip": 5.0},
    "dahl_friction": {"cap": 6e-3, "slip": 5.0},
    "standard_linear_solid": {"stiffness": 2e-3, "relaxation": 0.05},
    "grasp_play": {"cap": 0.05, "slip": 0.1},
}


@pytest.mark.long
@pytest.mark.parametrize("name", MILD_VALUES)
def test_all_integrators_give_the_same_motion(name, arm, motion):
    """A string moves the same with any integrator, and at a twentieth of the step.

    Its memory moves its tip by more than 5 mm.
    """
    model = ordinary(arm).with_effects(effects_by_name()[name])
    values = {f"{name}.{key}": value for key, value in MILD_VALUES[name].items()}
    exact = tip(model, motion, values, RungeKutta4(), 5e-5)
    for integrator, step, close in (
        (SemiImplicitEuler(), 1e-5, 1e-4),
        (ImplicitLeapfrog(), 5e-5, 3e-4),
    ):
        assert (
            np.abs(tip(model, motion, values, integrator, step) - exact).max() < close
        )
    assert np.abs(tip(model, motion, {}, RungeKutta4(), 5e-5) - exact).max() > 0.005
    plain = tip(ordinary(arm), motion, {}, RungeKutta4(), 5e-5)
    np.testing.assert_allclose(
        tip(model, motion, {}, RungeKutta4(), 5e-5), plain, atol=1e-12
    )


def with_maxwell_slip(arm):
    """Return the ordinary model with slips, and the integrator that a setup compiles."""
    model = ordinary(arm).with_effects(effects_by_name()["maxwell_slip"])
    return replace(model, string=replace(model.string, integrator=ImplicitLeapfrog()))


def test_a_string_at_rest_has_no_memory(arm):
    """The hinges of a string that hangs at rest hold no moment.

    It hangs as without friction. It stays there if it starts in equilibrium or is
    released there.
    """
    model = with_maxwell_slip(arm)
    resting_motion = resample_joint_motion(
        np.arange(0, 0.3, 0.005), np.tile([0.4, 0.2, 0.1], (60, 1))
    )
    values = {"maxwell_slip.cap": 5e-3, "maxwell_slip.slip": 0.5}
    held, free = (
        tip(model, resting_motion, parameters, ImplicitLeapfrog(), 1e-4)
        for parameters in (values, {})
    )
    np.testing.assert_allclose(held, np.tile(free[0], (80, 1)), atol=1e-9)
    hand, times = resting_motion.hand_motion(arm), resting_motion.tick * np.arange(60)
    given = model.string.material(model.values(TRUTH | values)[None])
    angles, _ = hanging_shape(model.string, given, hand.pose[:, 0])
    initial = StringState(
        0.0, model.string.segment_middles(), angles[0], np.zeros_like(angles[0])
    )
    points = simulate(
        model.string, hand, model.values(TRUTH | values)[None], times, initial
    ).points
    np.testing.assert_allclose(points[0, :, -1], np.tile(free[0], (60, 1)), atol=1e-6)


def test_displacement_within_the_slip_only_stiffens_a_string(arm):
    """A string pulled aside within its slip is only stiffer.

    A string that starts displaced was pulled there slowly. A sticking element adds cap
    / slip to the stiffness.
    """
    string = with_maxwell_slip(arm).string
    down = HandMotion(
        0.0, 0.005, np.tile([0.0, 0.0, -np.pi / 2], (1, 61, 1)), np.zeros((1, 61, 3))
    )
    pulled = StringState(
        0.0,
        string.segment_middles(),
        -np.pi / 2 + 0.5 * string.segment_middles(),
        np.zeros(string.points - 1),
    )
    stiff = TRUTH | {"bending_stiffness": 30 * TRUTH["bending_stiffness"]}
    stiffness = string.material(string.values(stiff))[
        string.names.index("bending_stiffness")
    ]
    sticks = stiff | {"maxwell_slip.cap": 4.0 * stiffness, "maxwell_slip.slip": 4.0}
    stiffer = stiff | {"bending_stiffness": 2 * stiff["bending_stiffness"]}
    values = np.stack([string.values(each) for each in (sticks, stiffer, stiff)])
    tips = simulate(string, down, values, 0.005 * np.arange(61), pulled).tip
    assert np.abs(tips[0] - tips[1]).max() < 1e-4
    assert np.abs(tips[0] - tips[2]).max() > 1e-3


@pytest.mark.parametrize(
    ("name", "times", "where"),
    [
        ("maxwell_slip", 1.0, 1),
        ("dahl_friction", 2.0, 1),
        ("standard_linear_solid", 1.0, 1),
        ("grasp_play", 1.0, 2),
    ],
)
def test_the_step_bound_covers_the_stiffness_after_a_reversal(name, times, where, arm):
    string = ordinary(arm).with_effects(effects_by_name()[name]).string
    values = {f"{name}.{key}": value for key, value in PARAMETER_VALUES[name].items()}
    steepest = memory_stiffness_bounds(
        string, string.material(string.values(TRUTH | values)[None])
    )[:, 0]
    np.testing.assert_allclose(
        steepest, times * CAP / SLIP * np.eye(3)[where], rtol=1e-3
    )


def test_several_effects_of_a_kind_are_numbered(arm):
    """Several effects of a kind are named by numbers.

    Two slips in parallel with the same slip curvature equal one with the sum of the
    caps.
    """
    both = ordinary(arm).with_effects(*find_effects(["maxwell_slip", "maxwell_slip_2"]))
    assert {"maxwell_slip.cap", "maxwell_slip_2.cap"} <= set(both.names)
    string = both.string
    one = ordinary(arm).with_effects(*find_effects(["maxwell_slip"])).string
    values = {
        "maxwell_slip.slip": SLIP,
        "maxwell_slip_2.slip": SLIP,
        "maxwell_slip.cap": CAP,
        "maxwell_slip_2.cap": CAP,
    }
    twice = memory_stiffness_bounds(
        string, string.material(string.values(TRUTH | values)[None])
    )[1]
    single = one.values(
        TRUTH | {"maxwell_slip.slip": SLIP, "maxwell_slip.cap": 2 * CAP}
    )
    assert twice == pytest.approx(
        memory_stiffness_bounds(one, one.material(single[None]))[1], rel=1e-6
    )
    with pytest.raises(ValueError, match="no effect 'maxwell_slip_1'"):
        find_effects(["maxwell_slip_1"])
