"""What causes of a laboratory mean: absent they change nothing, and there they move the
string as the library's do.
"""

import numpy as np
import pytest

from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from tests.benchmarks.simulators.laboratory import laboratory
from tests.benchmarks.simulators.laboratory.causes import CAUSES, NAMED, Plain
from tests.benchmarks.simulators.laboratory.hand import Hand, path
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import CHECK, ROUGH, Cast, Scene

pytestmark = pytest.mark.long
POINTS = 41
# Parameters of the library that a laboratory's own law has no equal of, to first order
# where it is small.
NEAR = {
    "rub": lambda so: {"maxwell_slip.slip": so["rod.rub_curvature"]},
    "hardening": lambda so: {"nonlinear_bending.hardening": so["rod.hardening"] / 2},
    "across": lambda so: {"anisotropic_drag.excess": so["rod.across"]},
    "slip": lambda so: {
        "grasp_slip.duration": so["hand.slip_until"] - so["hand.slip_from"]
    },
    "plane": lambda so: {
        "contact.stiffness": so["rod.plane"],
        "contact.friction": so["rod.plane_friction"],
    },
}


@pytest.fixture(scope="module")
def scene(arm, camera):
    """A swing of all joints and back, so gentle that a small cause has a small and even
    effect.
    """
    t = np.arange(0, 0.8, 0.001)
    x = np.clip((t - 0.05) / 0.5, 0, 1)
    way = np.sin(np.pi * x) ** 3 * np.sin(2.5 * np.pi * x)
    angles = np.array([0.8, -1.2, -0.9]) + way[:, None] * np.array([0.12, 0.1, 0.14])
    base = {
        "axial_stiffness": 6e5,
        "axial_damping": 30.0,
        "bending_stiffness": 8.0,
        "bending_damping": 6e-3,
    }
    base |= {
        "linear_drag": 0.3,
        "quadratic_drag": 0.2,
        "grasp_stiffness": 3.0,
        "grasp_damping": 5e-3,
    }
    cast = Cast(t, angles, t, angles, np.arange(0.0, 0.75, 0.01))
    return Scene(
        laboratory("nodal"),
        arm,
        camera,
        Rod.of_points(0.3, **base),
        (cast,),
        np.linspace(0, 0.3, 13),
        1e-3,
    )


@pytest.fixture(scope="module")
def plain(scene):
    hand = path(scene.arm, scene.casts[0].fine, scene.casts[0].angles, Hand()).at(
        scene.casts[0].fine
    )[:, :2]
    return Plain(
        scene.rod, (scene.casts[0].frames,), tuple(scene.seen({}, ROUGH)), (hand,)
    )


@pytest.fixture(scope="module")
def modelled(scene):
    """What the model sees with effects, (F, S, 2)."""

    def seen(effects, values):
        string = String(
            0.3,
            POINTS,
            tip_cell=0.5,
            grasp_cell=0.5,
            integrator=ImplicitLeapfrog(),
            largest_step=4e-4,
        )
        model = Model(string, scene.arm, scene.camera).with_effects(
            *find_effects(effects)
        )
        cast = scene.casts[0]
        motion = resample_joint_motion(cast.fine, cast.angles, 0.001)
        rows = model.values({**scene.rod.in_points(), **values})[None]
        return model.simulate_observation(motion, rows, cast.frames).points[0][
            :, :: (POINTS - 1) // 10
        ]

    return seen


def placed(cause, plain):
    """The cause in circumstances; not all seeds have a place for it."""
    drawn = (cause.hidden(np.random.default_rng(seed), plain) for seed in range(200))
    return next(hidden for hidden in drawn if hidden is not None)


@pytest.mark.parametrize(
    "cause", [c for c in CAUSES if c.name != "plane"], ids=lambda c: c.name
)
def test_a_cause_that_is_absent_leaves_the_null_and_one_that_is_there_does_not(
    cause, scene, plain
):
    hidden = placed(cause, plain)
    absent, there = (
        np.abs(scene.seen(hidden.at(share), ROUGH)[0] - plain.strings[0]).max()
        for share in (0.0, 0.5)
    )
    assert absent < 1e-9
    assert there > 1e-6


@pytest.mark.parametrize(
    "cause", [c for c in CAUSES if c.library], ids=lambda c: c.name
)
def test_a_cause_moves_the_tip_as_the_librarys_effect_of_that_name(
    cause, scene, plain, modelled
):
    so = placed(cause, plain).at(0.4 if cause.name == "plane" else 0.1)
    parameters = {**cause.comparable(so), **NEAR.get(cause.name, lambda so: {})(so)}
    ours = scene.seen(so, CHECK)[0][:, -1] - scene.seen({}, CHECK)[0][:, -1]
    theirs = modelled([cause.library[0]], parameters)[:, -1] - modelled([], {})[:, -1]
    assert np.abs(ours).max() > 2e-4
    assert np.vdot(ours, theirs) > 0.97 * np.linalg.norm(ours) * np.linalg.norm(theirs)
    assert 0.8 < np.linalg.norm(ours) / np.linalg.norm(theirs) < 1.25


def test_what_is_outside_acts_where_and_when_it_says(scene, plain):
    """A peg keeps the string out; a blow, a gust, a hand that takes hold act in their
    time; a thread holds the tip.
    """
    peg = placed(NAMED["peg"], plain).at(1.0)
    points = scene.seen(peg, CHECK)[0][:, 1:]
    away = np.linalg.norm(points - [peg["rod.peg_x"], peg["rod.peg_y"]], axis=-1)
    assert away.min() > 0.5 * peg["rod.peg_radius"]
    for name, when in (
        ("blow", "rod.blow_when"),
        ("gust", "rod.gust_when"),
        ("hold", "rod.hold_from"),
    ):
        so = placed(NAMED[name], plain).at(0.3)
        moved = np.abs(scene.seen(so, ROUGH)[0] - plain.strings[0]).max(axis=(1, 2))
        before = plain.times[0] < so[when] - 0.3
        assert moved[before].max(initial=0.0) < 1e-4
        assert moved.max() > 1e-3
    thread = placed(NAMED["thread"], plain)
    anchor = [thread.full["rod.thread_x"], thread.full["rod.thread_y"]]
    far = [
        np.linalg.norm(scene.seen(so, CHECK)[0][:, -1] - anchor, axis=-1).max()
        for so in ({}, thread.full)
    ]
    assert far[1] < 0.8 * far[0]
