"""Guard and start check refuse NaN."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rig import ARM, DRIVING, WORKSPACE, movement

from stringcast.data.artifacts import JOINTS
from stringcast.hardware.arm import VelocityArm
from stringcast.hardware.arm.limits import Workspace, check_movement
from stringcast.hardware.arm.loop import Guard, reserve_log
from stringcast.hardware.arm.record import build_performance
from stringcast.hardware.serial.protocol import (
    DeviceState,
    FrameError,
    Report,
    decode_answer,
    encode_answer,
)
from stringcast.stages.execute.interfaces import HardwareError

BAD = [float("nan"), float("inf"), -float("inf")]


@pytest.mark.parametrize("bad", BAD)
def test_nan_angles_are_refused_by_the_decoder(bad):
    good = Report(7, 5000, DeviceState.MOVING, (0.1, 0.2, 0.3))
    assert decode_answer(encode_answer(good)[:-1]).sequence == 7
    with pytest.raises(FrameError, match="encoder reports no number"):
        decode_answer(encode_answer(replace(good, angles=(0.1, bad, 0.3)))[:-1])


def guard_reason(angles, astray=0.5, before=(0.0, 0.0, 0.0)):
    log = reserve_log(np.zeros(3), np.zeros((4, 3)), ARM.tick)
    log.device_time[:3] = [0.0, 0.005, 0.010]
    log.angles[1], log.angles[2] = before, angles
    log.last_checked, log.last_answered = 1, 2
    return Guard(ARM, 4, astray, lambda: "").stop_reason(log, 3)


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("bad", BAD)
def test_guard_stops_for_nan(bad, joint):
    angles = np.zeros(3)
    assert guard_reason(angles) == ""
    angles[joint] = bad
    assert guard_reason(angles) == "an encoder reports no number"
    assert guard_reason(np.zeros(3), before=angles).startswith(
        f"the encoder of joint {joint + 1} jumped"
    ) or not np.isnan(bad)
    assert guard_reason(np.zeros(3), astray=float("nan")) != ""


def test_guard_checks_the_first_answer():
    log = reserve_log(np.zeros(3), np.zeros((4, 3)), ARM.tick)
    log.device_time[0], log.angles[0], log.last_answered = 0.0, np.nan, 0
    assert (
        Guard(ARM, 4, 0.5, lambda: "").stop_reason(log, 0)
        == "an encoder reports no number"
    )


class Wire:
    """A wire that reports a pose and accepts no command."""

    port, watchdog = "here", 0.25

    def __init__(self, pose, watchdog=0.25):
        self.pose, self.watchdog = pose, watchdog

    def angles(self):
        return tuple(self.pose)

    def send(self, speeds):
        raise AssertionError("it was moved")


@pytest.mark.parametrize("bad", BAD)
def test_no_movement_starts_from_nan(bad):
    arm = VelocityArm(ARM, Wire([0.0, bad, 0.0]), DRIVING)
    for begin in (
        lambda: arm.perform(movement()),
        lambda: arm.move_to([0.1, 0.1, 0.1]),
    ):
        with pytest.raises(HardwareError, match="encoder reports no number"):
            begin()


@pytest.mark.parametrize(
    "limits",
    [
        {"lowest": (math.nan,) * 3},
        {"highest": (math.nan,) * 3},
        {"speed": (math.nan,) * 3},
        {"acceleration": (math.nan,) * 3},
        {"hand_speed": math.nan},
    ],
)
def test_nan_limit_refuses_all_movements(limits):
    angles = movement()[list(JOINTS)].to_numpy()
    check_movement(ARM, WORKSPACE, angles)
    arm = SimpleNamespace(
        **vars(ARM) | limits,
        commanded_velocities=ARM.commanded_velocities,
        grasp_velocity=ARM.grasp_velocity,
        joint_positions=ARM.joint_positions,
    )
    with pytest.raises(HardwareError, match=r"leaves arm\."):
        check_movement(arm, WORKSPACE, angles)


def test_nan_movement_is_refused():
    with pytest.raises(HardwareError, match="no numbers"):
        check_movement(ARM, WORKSPACE, np.full((3, 3), math.nan))


def test_nan_workspace_is_refused():
    with pytest.raises(ValueError, match="below"):
        Workspace((math.nan, -0.4), (0.8, 0.8))
    assert WORKSPACE.is_left_by(np.array([[0.0, math.nan]]))


def test_link_with_nan_times_is_refused():
    for driving, watchdog in (
        (replace(DRIVING, round_trip=math.nan), 0.25),
        (DRIVING, math.nan),
    ):
        with pytest.raises(HardwareError, match=r"round trip|watchdog"):
            VelocityArm(ARM, Wire([0.0] * 3, watchdog), driving)._test_link()


def test_unsent_ticks_count_as_missed():
    log = reserve_log(np.zeros(3), np.zeros((4, 3)), ARM.tick)
    log.sent[:] = log.due
    log.acknowledged[:] = log.due
    log.device_time[:] = log.due
    log.angles[:] = 0.0
    log.sent[2] = np.nan
    performance = build_performance(log, 0.0, 0.1, 0.5, np.ones(3))
    assert performance.ticks["missed"].tolist() == [False, False, True, False]
    assert performance.arm["t"].tolist() == [*log.due[:2], log.due[3]]
    assert performance.link["jitter_max"].item() == 0


def test_expected_angles_are_integrated_velocities():
    speeds = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    expected = [[0.5, 0.5, 0.5], [0.505, 0.5, 0.5], [0.505, 0.51, 0.5]]
    np.testing.assert_allclose(
        reserve_log(np.full(3, 0.5), speeds, 0.005).expected, expected
    )
