"""The velocity loop on a scripted wire: all reasons to stop."""

import gc
import os
import signal

import numpy as np
import pytest
from rig import ARM, DRIVING, movement

from stringcast.hardware.arm import ArmAnswer, Driving, VelocityArm
from stringcast.hardware.arm.clock import real_time_priority
from stringcast.hardware.arm.loop import reserve_log
from stringcast.hardware.arm.record import build_performance
from stringcast.stages.execute.interfaces import HardwareError


class ScriptedWire:
    """A wire with a perfect arm; `spoil` changes answers (None: lost)."""

    port, watchdog = "script", 0.025

    def __init__(self, spoil=lambda answer: answer):
        self.spoil, self.sent, self.calls, self.due = spoil, [], [], []
        self.pose = np.zeros(3)

    def open(self):
        self.calls.append("open")

    def set_limits(self, arm):
        self.limits = arm.speed

    def close(self):
        self.calls.append("close")

    def angles(self):
        return tuple(self.pose)

    def send(self, speeds):
        number = len(self.sent)
        answer = self.spoil(ArmAnswer(number, 0.005 * number, "", tuple(self.pose)))
        self.due += [answer] if answer else []
        self.sent.append(np.array(speeds))
        self.pose = self.pose + 0.005 * np.array(speeds)
        return number, np.array(speeds)

    def answers(self):
        due, self.due = self.due, []
        return due

    def stop(self):
        self.calls.append("stop")

    def latch(self):
        self.calls.append("latch")

    def clear(self):
        self.calls.append("clear")


def change_answers_from(number, change):
    """Return a function that changes answers from a number on."""
    return lambda answer: change(answer) if answer.number >= number else answer


def turn_last_joint(answer, by):
    return ArmAnswer(
        answer.number,
        answer.clock,
        "",
        (answer.angles[0], answer.angles[1] + by, answer.angles[2]),
    )


def driver(wire, **changed):
    return VelocityArm(ARM, wire, Driving(**{**vars(DRIVING), "misses": 4, **changed}))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda answer: None, r"no answer for 5 ticks at 0\.175 s"),
        (
            lambda answer: ArmAnswer(
                answer.number, answer.clock, "the device restarted", answer.angles
            ),
            "device restarted",
        ),
        (lambda answer: turn_last_joint(answer, 0.3), "encoder of joint 2 jumped"),
        (
            lambda answer: turn_last_joint(answer, -0.02 * (answer.number - 30)),
            r"joint 2 is 0\.\d+ rad from where it was sent",
        ),
    ],
    ids=["silence", "held", "jump", "astray"],
)
def test_all_reasons_to_stop_ramp_the_arm_to_rest(change, reason):
    wire = ScriptedWire(change_answers_from(30, change))
    with pytest.raises(HardwareError, match=reason), driver(wire, astray=0.2) as arm:
        arm.perform(movement())
    assert not wire.sent[-1].any()
    assert len(wire.sent) < len(movement()) - 5
    assert (
        np.abs(np.diff(wire.sent, axis=0)).max() / ARM.tick
        <= max(ARM.acceleration) * 1.001
    )
    assert wire.calls == ["open", "stop", "stop", "close"]


def test_allowed_misses_are_tolerated_and_reset():
    lost = {10, 11, 12, 13, 20, 21, 22, 23}
    wire = ScriptedWire(lambda answer: None if answer.number in lost else answer)
    with driver(wire) as arm:
        ticks = arm.perform(movement()).ticks
    assert set(ticks.index[ticks["t_acknowledged"].isna()]) == lost
    assert set(ticks.index[ticks["missed"]]) >= lost


def test_encoder_jump_during_a_lost_answer_is_found():
    wire = ScriptedWire(
        lambda answer: (
            None
            if answer.number == 30
            else turn_last_joint(answer, 0.5 * (answer.number > 30))
        )
    )
    with pytest.raises(HardwareError, match="joint 2 jumped"), driver(wire) as arm:
        arm.perform(movement())


def test_emergency_stop_sends_only_the_latch():
    wire = ScriptedWire()
    arm = driver(wire)
    wire.spoil = change_answers_from(
        20, lambda answer: (arm.press_emergency_stop("button"), answer)[1]
    )
    with pytest.raises(HardwareError, match=r"emergency stop \(button\)"), arm:
        arm.perform(movement())
    assert len(wire.sent) == 21
    assert wire.calls[1] == "latch"
    with pytest.raises(HardwareError, match="latched by the emergency stop"), arm:
        arm.perform(movement())
    assert len(wire.sent) == 21


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, MemoryError])
def test_exceptions_during_a_movement_latch_stop_and_close(error):
    def fail(answer):
        raise error

    wire = ScriptedWire(change_answers_from(20, fail))
    with pytest.raises(error), driver(wire) as arm:
        arm.perform(movement())
    assert wire.calls == ["open", "latch", "stop", "close"]


@pytest.mark.parametrize("way", ["latch", "stop", "close"])
def test_failing_stop_method_does_not_prevent_the_others(way):
    """Signal handlers are also restored."""
    before = signal.getsignal(signal.SIGINT)
    wire = ScriptedWire(change_answers_from(20, lambda answer: 1 // 0))
    setattr(wire, way, lambda: (wire.calls.append(way), {}["broken"]))
    with pytest.raises(KeyError, match="broken"), driver(wire) as arm:
        arm.perform(movement())
    assert wire.calls == ["open", "latch", "stop", "close"]
    assert signal.getsignal(signal.SIGINT) is before


def test_exception_at_rest_stops_and_closes_without_a_latch():
    wire = ScriptedWire()
    wire.pose = np.ones(3)
    with (
        pytest.raises(HardwareError, match="degrees from the movement's start"),
        driver(wire) as arm,
    ):
        arm.perform(movement())
    assert wire.calls == ["open", "stop", "close"]


@pytest.mark.parametrize("priority", [0, 10])
def test_loop_restores_process_settings(priority):
    before = os.sched_getscheduler(0), gc.isenabled()
    with real_time_priority(priority):
        assert not gc.isenabled()
    assert (os.sched_getscheduler(0), gc.isenabled()) == before


def test_angle_times_are_midpoints_of_the_quickest_exchanges():
    """Late and lost answers must not shift the clock."""
    log = reserve_log(np.zeros(3), np.zeros((40, 3)), 0.005)
    log.sent, log.speeds_sent, log.angles = log.due, log.commanded, np.zeros((40, 3))
    log.device_time = 7.0 + log.sent + 0.001
    log.acknowledged = log.sent + 0.002 + 0.006 * (np.arange(40) % 2)
    log.acknowledged[20] = np.nan
    made = build_performance(log, -0.2, late=0.0025, most_missed=0.0, trips=np.ones(1))
    moments = np.delete(log.sent, 20) - 0.2 + 0.001
    np.testing.assert_allclose(made.arm["t"], moments, atol=1e-9)
