"""Laws with memory in motion.

They are compared with mechanics, an independent integration of a rod, and smaller
steps.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from stringcast.stages.model.effects.axial_damper import AxialDamper
from stringcast.stages.model.effects.axial_spring import AxialSpring
from stringcast.stages.model.effects.grasp_spring import GraspSpring
from stringcast.stages.model.effects.hinge_damper import HingeDamper
from stringcast.stages.model.effects.hinge_spring import HingeSpring
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.integrators import SemiImplicitEuler
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.state import StringState
from stringcast.stages.model.string import PAPER_EFFECTS, String
from tests.laws.weightless import MEMORY_EFFECTS, WEIGHTLESS_WITH_MEMORY

LENGTH = 0.3
FORCES = (AxialSpring, AxialDamper, HingeSpring, HingeDamper, GraspSpring)
MEMORY = tuple(effect.name for effect in MEMORY_EFFECTS)
FIRM_GRASP = {
    "axial_stiffness": 2e4,
    "axial_damping": 2.0,
    "bending_damping": 0.0,
    "grasp_stiffness": 1e4,
    "grasp_damping": 0.0,
    "linear_drag": 0.0,
    "quadratic_drag": 0.0,
}
# One hinge that moves: two segments, of which the first is held firmly. Its end has the
# mass of a segment.
HINGE = String(
    LENGTH,
    3,
    WEIGHTLESS_WITH_MEMORY,
    integrator=ImplicitLeapfrog(),
    largest_step=2e-4,
)
SEGMENT = LENGTH / 2
STIFFNESS = 0.05  # [m4/s2]
# [rad/s]; mass and inertia are those of a point, SEGMENT**3
FREQUENCY = np.sqrt(STIFFNESS / SEGMENT**4)


def release(string, material, shape, t, theta=0.0):
    """Return the points (F, n, 2) of a string released from given angles.

    Its hand is at rest at 0.
    """
    hand = HandMotion(
        0.0, 0.005, np.tile([0.0, 0.0, theta], (1, len(t), 1)), np.zeros((1, len(t), 3))
    )
    reference = string.length / (string.reference_points - 1)
    per_point = {
        p.name: material.get(p.name, p.start) / reference**p.length_power
        for p in string.parameters
    }
    start = StringState(
        0.0,
        string.segment_middles(),
        np.asarray(shape, dtype=float),
        np.zeros(string.points - 1),
    )
    return simulate(string, hand, string.values(per_point)[None], t, start).points[0]


def release_hinge(named, curvature, seconds=2.0, string=HINGE):
    """Release the one hinge from a curvature; return its curvature over time."""
    t = np.arange(0, seconds, 0.005)
    material = FIRM_GRASP | {"bending_stiffness": STIFFNESS} | named
    points = release(string, material, [0.0, curvature * SEGMENT], t)
    first, second = np.moveaxis(np.diff(points, axis=1), 1, 0)
    turn = np.arctan2(
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0],
        np.sum(first * second, axis=1),
    )
    return t, turn / SEGMENT


def find_extremes(t, x):
    """Find times and sizes of the extremes, by parabolas through three points."""
    at = 1 + np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0)
    before, extreme, after = x[at - 1], x[at], x[at + 1]
    share = 0.5 * (before - after) / (before - 2 * extreme + after)
    return t[at] + share * (t[1] - t[0]), np.abs(
        extreme - 0.25 * (before - after) * share
    )


@pytest.mark.parametrize("name", ["maxwell_slip", "dahl_friction"])
def test_a_cap_reduces_each_swing_by_the_same_amount(name):
    """Under a cap each swing is smaller than the last by the same amount.

    The amount is 2 cap / stiffness, minus the elastic part of the slip. It follows from
    the energies at successive ends of a swing.
    """
    start, cap, slip = 6.0, 0.25 * STIFFNESS, 0.02
    t, curvature = release_hinge({f"{name}.cap": cap, f"{name}.slip": slip}, start, 4.0)
    _, ends = find_extremes(t, curvature)
    ends = ends[ends > 1.0]
    assert len(ends) >= 8
    lost = -np.diff(np.concatenate([[start], ends]))
    # elastic work after a reversal, over the cap
    back = 2 * slip * (1.0 if name == "maxwell_slip" else np.log(2))
    pairs = np.concatenate([[start], ends])
    np.testing.assert_allclose(
        lost, 2 * cap / STIFFNESS * (1 - back / (pairs[1:] + pairs[:-1])), rtol=0.02
    )


def test_a_sticking_hinge_swings_faster_than_a_slipping_one():
    """A hinge that sticks swings faster than one that slips.

    With K = 3 B the frequency is twice as high. A swing of a hundred times the slip
    curvature has the frequency without friction.
    """
    slip = 0.05
    named = {"maxwell_slip.cap": 3 * STIFFNESS * slip, "maxwell_slip.slip": slip}
    periods = []
    for start in (0.5 * slip, 120 * slip):
        at, _ = find_extremes(*release_hinge(named, start))
        periods.append(2 * np.diff(at)[:4].mean())
    np.testing.assert_allclose(
        np.array(periods) * FREQUENCY / (2 * np.pi), [0.5, 1.0], rtol=5e-3
    )


@pytest.mark.parametrize(
    # the second compiles another loop; its steps suit the stiff grasp
    ("integrator", "step"),
    [
        (ImplicitLeapfrog(), 1e-3),
        pytest.param(SemiImplicitEuler(), 1e-4, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(
    "name", ["maxwell_slip", "dahl_friction", "standard_linear_solid"]
)
def test_the_error_falls_at_least_linearly_with_the_step(name, integrator, step):
    """The error at half the step is at most half, and at a tenth a tenth."""
    values = (
        {"stiffness": STIFFNESS, "relaxation": 0.1}
        if "solid" in name
        else {"cap": 0.02, "slip": 0.4}
    )
    named = {f"{name}.{key}": value for key, value in values.items()}
    steps = (0.01 * step, step, 0.5 * step, 0.1 * step)
    exact, *found = (
        release_hinge(
            named, 6.0, 0.5, replace(HINGE, integrator=integrator, largest_step=each)
        )[1]
        for each in steps
    )
    error, half_error, tenth_error = (np.abs(each - exact).max() for each in found)
    assert error > 0.1 * step
    # the reference has an error of 1 % of the first
    assert half_error < 0.51 * error
    assert tenth_error < 0.1 * error


# --- an independent rod: absolute angles, no stretch, SciPy


ROD = String(
    LENGTH,
    4,
    (*PAPER_EFFECTS, *MEMORY_EFFECTS),
    integrator=ImplicitLeapfrog(),
    largest_step=2e-5,
)
STIFF = {"axial_stiffness": 4e5, "axial_damping": 20.0}
# absent by their values, so that no loop without them is compiled
STIFF |= dict.fromkeys(["grasp_damping", "linear_drag", "quadratic_drag"], 0.0)
KNOWN_VALUES = {
    "bending_stiffness": 0.02,
    "bending_damping": 2e-4,
    "grasp_stiffness": 0.2,
}
HELD_VALUES = {
    "maxwell_slip.cap": 0.02,
    "maxwell_slip.slip": 0.5,
    "dahl_friction.cap": 0.015,
    "dahl_friction.slip": 0.8,
    "standard_linear_solid.stiffness": 0.01,
    "standard_linear_solid.relaxation": 0.05,
    "grasp_play.cap": 0.05,
    "grasp_play.slip": 0.1,
}


def stop_rate(rate, held, limit):
    return np.where((np.abs(held) < limit) | (held * rate < 0), rate, 0.0)


def state_rate(theta, named):
    """Return the rates of a rod's state by Lagrange's equations in the links' angles.

    The state holds angles of three massless links with points at their ends (3), their
    rates (3), and the memory of two hinges (2, 2, 2) and of the grasp (1).
    """
    length = LENGTH / 3
    carried = length * np.arange(3, 0, -1)  # [m], mass at and beyond each link's end
    shared = length**2 * carried[np.maximum.outer(np.arange(3), np.arange(3))]
    slipping = (
        named["maxwell_slip.slip"],
        named["dahl_friction.slip"],
        named["grasp_play.slip"],
    )
    dry = ("maxwell_slip", "dahl_friction", "grasp_play")
    stiff, rubs, plays = (named[f"{name}.cap"] / named[f"{name}.slip"] for name in dry)

    def change(_, y):
        angle, rate, slip, dahl, solid, grasp = np.split(y, [3, 6, 8, 10, 12])
        bend, turning = np.diff(angle) / length, np.diff(rate) / length
        hinge = named["bending_stiffness"] * bend + named["bending_damping"] * turning
        hinge += (
            stiff * slip
            + rubs * dahl
            + named["standard_linear_solid.stiffness"] * solid
        )
        base = named["grasp_stiffness"] * (angle[:1] - theta) + plays * grasp
        turned = angle[:, None] - angle
        weight = 9.81 * length * carried * np.cos(angle)
        force = (
            np.diff(np.concatenate([base, hinge, [0.0]]))
            - weight
            - (shared * np.sin(turned)) @ rate**2
        )
        return np.concatenate(
            [
                rate,
                np.linalg.solve(shared * np.cos(turned), force),
                stop_rate(turning, slip, slipping[0]),
                turning - np.abs(turning) * dahl / slipping[1],
                turning - solid / named["standard_linear_solid.relaxation"],
                stop_rate(rate[:1], grasp, slipping[2]),
            ]
        )

    return change


def integrate_rod(shape, t, theta, named):
    """Return the tip (F, 2) of the rod, integrated independently.

    It was pulled slowly from rest to these angles of its links and released.
    """
    change = state_rate(theta, named)
    rest = fsolve(
        lambda angle: change(0, np.concatenate([angle, np.zeros(10)]))[3:6],
        np.full(3, theta),
    )
    pulled = 3 / LENGTH * np.diff(shape - rest)
    slip, dahl = named["maxwell_slip.slip"], named["dahl_friction.slip"]
    held = [
        np.clip(pulled, -slip, slip),
        np.sign(pulled) * dahl * (1 - np.exp(-np.abs(pulled) / dahl)),
        np.zeros(2),
    ]
    held += [
        np.clip((shape - rest)[:1], -named["grasp_play.slip"], named["grasp_play.slip"])
    ]
    start = np.concatenate([shape, np.zeros(3), *held])
    found = solve_ivp(
        change, (0, t[-1]), start, "BDF", t, rtol=1e-7, atol=1e-9, max_step=2e-3
    )
    return (
        LENGTH / 3 * np.stack([np.cos(found.y[:3]), np.sin(found.y[:3])]).sum(axis=1).T
    )


@pytest.mark.parametrize(
    "law", [*(pytest.param(name, marks=pytest.mark.long) for name in MEMORY), "all"]
)
def test_an_independent_integration_of_a_rod_agrees(law):
    """An independently integrated rod moves the same within 0.05 mm.

    Most of the difference is the stretch, which the rod lacks. Memory moves the tip by
    more than 5 mm.
    """
    absent = (
        HELD_VALUES
        | {name: 0.0 for name in HELD_VALUES if name.endswith(("cap", "stiffness"))}
        | KNOWN_VALUES
    )
    named = absent | {
        name: value
        for name, value in HELD_VALUES.items()
        if law in ("all", name.split(".")[0])
    }
    t, theta, shape = np.arange(0, 0.4, 0.005), -0.6, np.array([-0.4, -0.1, 0.5])
    tip = release(ROD, STIFF | named, shape, t, theta)[:, -1]
    expected, without = (
        integrate_rod(shape, t, theta, each) for each in (named, absent)
    )
    assert np.abs(tip - expected).max() < 5e-5
    assert np.abs(without - expected).max() > 5e-3


# --- a new law in one file


LAW = """
    @staticmethod
    def hinge_memory(memory: Quantity, change: Quantity, dt: Quantity, slip: Quantity, creep: Quantity) -> Quantity:
        return np.minimum(np.maximum(memory + change, -slip), slip) / (1.0 + dt / creep)

    @staticmethod
    def hinge_memory_moment(memory: Quantity, cap: Quantity, slip: Quantity) -> Quantity:
        return cap * memory / slip
"""
FILE = f'''"""Strands that stick, slip, and creep where they stick."""

import numpy as np

from stringcast.stages.model.effect import Parameter, Quantity, StringEffect, Values


class CreepingSlip(StringEffect):
    """A stop whose hold fades in time."""

    name = "creeping_slip"
    parameters = (
        Parameter("cap", "m3/s2", "moment over mass per length at which it slips", 0.0, 0.3, 0.0),
        Parameter("slip", "1/m", "curvature from rest at which it slips", 5e-3, 2.0, 0.1),
        Parameter("creep", "s", "time in which its hold fades", 0.01, 10.0, 1.0),
    )
    reference = "A test"

    @staticmethod
    def describe(values: Values) -> str:
        return f"bending sticks, slips and creeps within {{values['creep']:.2g}} s"
{LAW}'''


@pytest.mark.long
def test_a_law_with_memory_is_one_file_with_twelve_lines_of_law(
    effects_folder,
):
    """A law with memory is one file of which twelve lines are the law.

    Nothing else is edited. The law is found, runs, is absent at zero, and damps a
    swing. `test_law_page.py` has a quicker test, of a law without memory.
    """
    assert len([line for line in LAW.splitlines() if line.strip()]) <= 12
    (effects_folder / "creeping_slip.py").write_text(FILE)
    string = replace(HINGE, effects=(*FORCES, effects_by_name()["creeping_slip"]))
    known = {"creeping_slip.slip": 0.1, "creeping_slip.creep": 0.2}
    _, with_it = release_hinge(
        known | {"creeping_slip.cap": 0.2 * STIFFNESS}, 6.0, 1.0, string
    )
    _, absent = release_hinge(known, 6.0, 1.0, string)
    _, plain = release_hinge({}, 6.0, 1.0)
    np.testing.assert_allclose(absent, plain, atol=1e-9)
    assert np.abs(with_it[100:]).max() < 0.95 * np.abs(plain[100:]).max()
