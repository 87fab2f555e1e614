"""The virtual lab: reports and films agree with the simulated motion."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import JOINTS, Trial
from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench, VirtualCamera
from stringcast.hardware.virtual.obstacles import Box, Obstacles
from stringcast.hardware.virtual.render import Look, render_background, render_frame
from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.execute.execute import execute
from stringcast.stages.model.engine.integrators import RungeKutta4
from stringcast.stages.model.hand import resample_joint_motion


def test_velocity_loop_has_the_stated_bandwidth():
    servo = VirtualServo(bandwidth=40.0, repeatability=0.0, step=0.0001)
    t = np.arange(0, 2, 0.0001)
    gains = []
    for frequency in (1.0, 40.0):
        wave = np.sin(2 * np.pi * frequency * t)[:, None]
        fine, turned = servo.follow_commands(t, wave, np.random.default_rng(0))
        speed = np.gradient(turned[:, 0], fine)
        gains.append(np.ptp(speed[len(speed) // 2 :]) / 2)
    assert abs(gains[0] - 1) < 0.01
    assert abs(20 * np.log10(gains[1]) + 3) < 0.2


def test_string_is_rendered_at_its_position(camera):
    """Measured by the centroid of brightness along rows, for a slanted string."""
    look = Look(noise=0.0, texture=0.0, unevenness=0.0)
    string = np.stack([np.linspace(0.1, 0.15, 30), np.linspace(0.5, 0.2, 30)], axis=-1)
    wall = render_background(camera, look, 0)
    frame = (
        render_frame(camera, look, np.full((1, 4, 2), 5.0), string[None], wall) - wall
    )
    pixels = camera.pixels(string)
    for v in range(int(pixels[0, 1]) + 5, int(pixels[-1, 1]) - 5, 7):
        u = (frame[v] * np.arange(camera.width)).sum() / frame[v].sum()
        assert abs(u - np.interp(v, pixels[:, 1], pixels[:, 0])) < 0.3


def test_trials_are_reproducible_and_differ_by_number(arm, camera):
    from conftest import specimen, swing

    def film(trial):
        bench = VirtualBench(arm, camera, specimen("A"), seed=1, trial_number=trial)
        return execute(
            swing(duration=0.1),
            VirtualArm(bench),
            VirtualCamera(bench),
            before=0.02,
            after=0.02,
        )

    one, same, other = film(1), film(1), film(2)
    pd.testing.assert_frame_equal(one.arm, same.arm, check_exact=True)
    assert all(
        np.array_equal(a, b) for a, b in zip(one.images, same.images, strict=True)
    )
    assert not one.arm.equals(other.arm)
    for name, table in Trial.TABLES.items():
        table.check(getattr(one, name))


def test_soft_string_is_simulated_under_compression(arm, camera):
    """Compressed to 0.4 of its length, it agrees with a simulation in small steps."""
    from conftest import specimen, swing

    yielding = {
        "axial_stiffness": 1e4,
        "axial_damping": 2.0,
        "bending_stiffness": 0.03,
        "bending_damping": 0.004,
        "grasp_stiffness": 0.006,
        "grasp_damping": 0.02,
    }
    string = specimen("A")
    string = replace(string, points=40, parameters={**string.parameters, **yielding})
    bench = VirtualBench(arm, camera, string, seed=0)
    device, motion = VirtualArm(bench), swing(duration=0.3)
    device.move_to(motion.commands[list(JOINTS)].iloc[0].tolist())
    device.perform(motion.commands)
    t = np.arange(0, 0.3, 0.005)
    points = bench.string_at(t)
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert lengths.min() < 0.5 * bench.model.string.segment_length

    explicit = replace(
        bench.model.string,
        integrator=RungeKutta4(),
        largest_step=1e-5,
    )
    joints = resample_joint_motion(*bench.performed_motion, tick=0.001)
    model = replace(bench.model, string=explicit)
    expected = model.simulate_string(joints, bench.values, t).points[0]
    np.testing.assert_allclose(points, expected, atol=1e-5)


@pytest.mark.parametrize("name", ["A", "D"])
def test_the_lab_has_strings_without_a_mesh(arm, camera, name):
    """Estimated values would differ from those of a coarse chain.

    With 40 points, a tip mass of 0.25 of string B looked like one of 0.2492 in a slow
    swing.
    """
    from conftest import specimen

    t = np.arange(0, 1.0, 1e-3)
    start_rad = (0.6, -0.4, -0.3)
    angles = start_rad + 0.15 * np.sin(np.outer(t, (5, 6, 7))) ** 2
    bench = VirtualBench(arm, camera, specimen(name), 0, performed_motion=(t, angles))
    points = bench.specimen.points
    tips = []
    for count in (points, 3 * points // 2):
        string = replace(bench.specimen, points=count)
        tips.append(replace(bench, specimen=string).string_at(t[::5])[:, -1])
    apart = np.linalg.norm(tips[0] - tips[1], axis=-1)
    assert np.sqrt(np.mean(apart**2)) < 0.03e-3


def test_execute_films_rest_around_the_movement(filmed):
    trial, true = filmed("A", duration=0.3)
    t = trial.frames["t"].to_numpy()
    assert t[0] == -0.1
    assert abs(t[-1] - 0.4) < 1e-9
    assert (
        np.ptp(trial.arm[list(JOINTS)].to_numpy()[trial.arm["t"] < 0], axis=0).max()
        < 1e-3
    )
    assert np.isfinite(true).all()


HIDDEN = {
    "tip_mass": {"ratio": 0.1},
    "arm_lag": {"time_constant": 0.02},
    "rolling_shutter": {"readout": 0.004},
    "time_offset": {"offset": 0.006},
}


def test_hidden_effects_act_and_are_not_reported(arm, camera):
    """Tested for string, hand, camera and clocks."""
    from dataclasses import replace

    from conftest import specimen, swing

    def performed(hidden):
        bench = VirtualBench(
            arm, camera, replace(specimen("A"), points=12, hidden=hidden), seed=1
        )
        device = VirtualArm(bench)
        commands = swing(duration=0.2).commands
        device.move_to(commands[list(JOINTS)].iloc[0].tolist())
        return bench, device.perform(commands)

    times = np.linspace(0.02, 0.15, 8)
    plain, told = performed({})
    for name, size in HIDDEN.items():
        bench, also_told = performed({name: size})
        pd.testing.assert_frame_equal(told.arm, also_told.arm, check_exact=True)
        moved = np.abs(
            bench.camera_view(bench.string_at, times)
            - plain.camera_view(plain.string_at, times)
        ).max()
        assert moved > 1e-3, name
    late, _ = performed({"time_offset": {"offset": 0.006}})
    np.testing.assert_allclose(
        late.camera_view(late.joints_at, times),
        plain.joints_at(times + 0.006),
        atol=1e-12,
    )
    lagging, _ = performed({"arm_lag": {"time_constant": 0.02}})
    np.testing.assert_allclose(
        lagging.string_at(times)[:, 0], lagging.joints_at(times)[:, -1], atol=2e-5
    )


def test_unknown_hidden_effects_are_refused():
    from dataclasses import replace

    import pytest
    from conftest import specimen

    with pytest.raises(ValueError, match="Did you mean 'tip_mass'"):
        replace(specimen("A"), hidden={"tipmass": {}})
    with pytest.raises(ValueError, match=r"no parameter 'mass'\. Known are: ratio"):
        replace(specimen("A"), hidden={"tip_mass": {"mass": 1.0}})


def test_string_bounces_off_obstacles(arm, camera):
    """It enters two boxes by 3 mm at 4 to 6 m/s, instead of 47 and 52 mm."""
    from conftest import specimen, swing

    boxes = (Box(0.0, 0.85, 0.2, 0.2), Box(0.85, 0.4, 0.2, 0.2))

    def deepest(obstacles):
        bench = VirtualBench(arm, camera, specimen("A"), seed=1, obstacles=obstacles)
        device = VirtualArm(bench)
        commands = swing(duration=0.5).commands
        device.move_to(commands[list(JOINTS)].iloc[0].tolist())
        device.perform(commands)
        x, y = bench.string_at(np.linspace(0, 0.6, 601)).T
        return [
            np.minimum(b.w / 2 - np.abs(x - b.x), b.h / 2 - np.abs(y - b.y)).max()
            for b in boxes
        ]

    free, stopped = deepest(Obstacles()), deepest(Obstacles(boxes))
    assert min(free) > 0.04
    assert min(stopped) > 1e-3
    assert max(stopped) < 5e-3
