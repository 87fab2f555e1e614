"""Meaning of causes.

Absent causes change nothing. Present ones act as the library's do.
"""

import numpy as np
import pytest

from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.causes import (
    LIBRARY_CAUSES,
    OUTSIDE_CAUSES,
    PlainTrials,
)
from tests.benchmarks.simulators.motions import Cast
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity, Scene
from tests.conftest import TRUTH, implicit_string

pytestmark = pytest.mark.long
POINTS = 41
CAUSES = {cause.name: cause for cause in (*LIBRARY_CAUSES, *OUTSIDE_CAUSES)}
BASE = TRUTH | {
    "bending_stiffness": 8.0,
    "bending_damping": 6e-3,
    "grasp_stiffness": 3.0,
}


# Settings that mean the same as a parameter of the library where a cause is small.
NEARLY_SAME = {
    "maxwell_slip.cap": "rod.friction",
    "maxwell_slip.slip": "rod.friction_curvature",
    "anisotropic_drag.excess": "rod.cross_drag",
    "lens_distortion.radial": "camera.lens",
    "contact.stiffness": "rod.plane",
    "contact.friction": "rod.plane_friction",
}


def library_parameters(cause, settings):
    """Return the parameters of the library that mean the same as settings."""
    parameters = cause.parameters(settings)
    for parameter, setting in NEARLY_SAME.items():
        if setting in settings:
            parameters[parameter] = settings[setting]
    if cause.name == "nonlinear_bending":
        parameters["nonlinear_bending.hardening"] = settings["rod.hardening"] / 2
    if cause.name == "grasp_slip":
        duration = settings["hand.slip_until"] - settings["hand.slip_from"]
        parameters["grasp_slip.duration"] = duration
    return parameters


@pytest.fixture(scope="module")
def scene(arm, camera):
    """Return a swing so gentle that a small cause has a small and even effect."""
    t = np.arange(0, 0.8, 0.001)
    x = np.clip((t - 0.05) / 0.5, 0, 1)
    progress = np.sin(np.pi * x) ** 3 * np.sin(2.5 * np.pi * x)
    swing = progress[:, None] * np.array([0.12, 0.1, 0.14])
    angles = np.array([0.8, -1.2, -0.9]) + swing
    cast = Cast(t, angles, t, angles, np.arange(0.0, 0.75, 0.01))
    rod = Rod.from_paper_parameters(0.3, **BASE)
    s = np.linspace(0, 0.3, 13)
    return Scene(load_simulator("nodal"), arm, camera, rod, (cast,), s, 1e-3)


@pytest.fixture(scope="module")
def plain(scene):
    [cast] = scene.casts
    hand = scene.grasp_path(cast, {}).states(cast.fine)[:, :2]
    string = scene.observe(cast, {}, Fidelity.SEARCH)
    return PlainTrials(scene.rod, (cast.frames,), (string,), (hand,))


@pytest.fixture(scope="module")
def modelled(scene):
    """Return a function that gives the points that the model sees, (F, S, 2).

    Its arguments are effects.
    """
    [cast] = scene.casts
    string = implicit_string(POINTS, 4e-4)
    motion = resample_joint_motion(cast.fine, cast.angles, 0.001)

    def see(effects, parameters):
        model = Model(string, scene.arm, scene.camera).with_effects(
            *find_effects(effects)
        )
        values = model.values({**scene.rod.paper_parameters(), **parameters})[None]
        points = model.simulate_observation(motion, values, cast.frames).points[0]
        return points[:, :: (POINTS - 1) // 10]

    return see


def hide(cause, plain):
    """Draw circumstances of a cause.

    Some seeds have no place for a cause.
    """
    for seed in range(200):
        hidden = cause.hide(np.random.default_rng(seed), plain)
        if hidden is not None:
            return hidden
    raise AssertionError


@pytest.mark.parametrize("name", [name for name in CAUSES if name != "contact"])
def test_a_cause_changes_nothing_absent_and_something_present(name, scene, plain):
    hidden = hide(CAUSES[name], plain)
    absent = scene.observe_all(hidden.settings(0.0), Fidelity.SEARCH)
    present = scene.observe_all(hidden.settings(0.5), Fidelity.SEARCH)
    assert np.abs(absent - plain.strings[0]).max() < 1e-9
    assert np.abs(present - plain.strings[0]).max() > 1e-6


@pytest.mark.parametrize("cause", LIBRARY_CAUSES, ids=lambda cause: cause.name)
def test_a_cause_moves_the_tip_as_the_librarys_effect(cause, scene, plain, modelled):
    settings = hide(cause, plain).settings(0.4 if cause.name == "contact" else 0.1)
    parameters = library_parameters(cause, settings)
    changed = scene.observe_all(settings, Fidelity.CHECK)[:, -1]
    ours = changed - scene.observe_all({}, Fidelity.CHECK)[:, -1]
    librarys = modelled([cause.name], parameters)[:, -1] - modelled([], {})[:, -1]
    our_size, their_size = np.linalg.norm(ours), np.linalg.norm(librarys)
    assert np.abs(ours).max() > 2e-4
    assert np.vdot(ours, librarys) > 0.97 * our_size * their_size
    assert 0.8 < our_size / their_size < 1.25


def test_a_peg_keeps_the_string_out(scene, plain):
    peg = hide(CAUSES["peg"], plain).settings(1.0)
    points = scene.observe_all(peg, Fidelity.CHECK)[:, 1:]
    centre = [peg["rod.peg_x"], peg["rod.peg_y"]]
    distance = np.linalg.norm(points - centre, axis=-1)
    assert distance.min() > 0.5 * peg["rod.peg_radius"]


@pytest.mark.parametrize(
    ("name", "when"),
    [("blow", "rod.blow_when"), ("gust", "rod.gust_when"), ("grip", "rod.grip_from")],
)
def test_a_timed_cause_acts_in_its_time(name, when, scene, plain):
    settings = hide(CAUSES[name], plain).settings(0.3)
    change = scene.observe_all(settings, Fidelity.SEARCH) - plain.strings[0]
    moved = np.abs(change).max(axis=(1, 2))
    before = plain.times[0] < settings[when] - 0.3
    assert moved[before].max(initial=0.0) < 1e-4
    assert moved.max() > 1e-3


def test_a_thread_holds_the_tip(scene, plain):
    thread = hide(CAUSES["thread"], plain).full
    anchor = [thread["rod.thread_x"], thread["rod.thread_y"]]

    def farthest(settings):
        tip = scene.observe_all(settings, Fidelity.CHECK)[:, -1]
        return np.linalg.norm(tip - anchor, axis=-1).max()

    assert farthest(thread) < 0.8 * farthest({})
