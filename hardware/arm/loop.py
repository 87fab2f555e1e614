"""The loop: a velocity every tick on an absolute schedule, and every reason to stop
looked at every tick.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stringcast.hardware.arm.clock import SPIN_S, real_time_priority, wait_until
from stringcast.hardware.arm.wire import ArmAnswer, Wire
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

POLL_S = 0.0003  # [s] between looks for an answer
DRAIN_S = 0.05  # [s] that the last answers may take
# [rad] by which an encoder may be off from one answer to the next
ENCODER_NOISE_RAD = 0.02


@dataclass
class MovementLog:
    """Arrays of every tick, reserved before the loop begins; NaN where nothing came."""

    due: np.ndarray
    commanded: np.ndarray
    expected: np.ndarray
    sent: np.ndarray
    acknowledged: np.ndarray
    device_time: np.ndarray
    speeds_sent: np.ndarray
    angles: np.ndarray
    start: float = 0.0
    last_answered: int = -1  # the latest tick that was answered
    last_checked: int = -1  # the latest when the guard last found nothing wrong
    hold_reason: str = ""
    # ticks by the number of their command
    pending_ticks: dict[int, int] = field(default_factory=dict)


def reserve_log(start: np.ndarray, speeds: np.ndarray, tick: float) -> MovementLog:
    """A log for velocities (K, J) [rad/s], played from the pose `start` (J,) [rad]."""
    count = len(speeds)
    turned = np.concatenate(
        [np.zeros((1, len(start))), np.cumsum(speeds[:-1], axis=0) * tick]
    )
    sent, acknowledged, clock = np.full((3, count), np.nan)
    carried, angles = np.full((2, *speeds.shape), np.nan)
    return MovementLog(
        np.arange(count) * tick,
        speeds,
        start + turned,
        sent,
        acknowledged,
        clock,
        carried,
        angles,
    )


@dataclass(frozen=True)
class Guard:
    """Limits whose violation ends a movement early.

    arm: its speed limits bound what an encoder can truly report. misses: unanswered
    ticks in a row that are borne. astray: largest distance from the commanded angles
    [rad]. pressed: the emergency stop, empty or a reason.
    """

    arm: Arm
    misses: int
    astray: float
    emergency_stop: Callable[[], str]

    def stop_reason(self, log: MovementLog, tick: int) -> str:
        """Empty if all is well after sending `tick`."""
        silent = tick - 1 - log.last_answered
        if silent > self.misses:
            return f"no answer for {silent} ticks"
        return log.hold_reason or self._angle_fault(log)

    def _angle_fault(self, log: MovementLog) -> str:
        """The fault that the angles measured since the last look reveal; empty if none."""
        ticks = np.arange(max(log.last_checked, 0), log.last_answered + 1)
        # several where this computer was late: each may show a jump
        ticks = ticks[np.isfinite(log.device_time[ticks])]
        if not np.isfinite(log.angles[ticks[ticks > log.last_checked]]).all():
            return "an encoder reports no number"
        if len(ticks) < 2:
            return ""
        leap = np.abs(np.diff(log.angles[ticks], axis=0)) - ENCODER_NOISE_RAD
        most = (
            2
            * np.asarray(self.arm.speed)
            * np.maximum(np.diff(log.device_time[ticks]), self.arm.tick)[:, None]
        )
        if not (leap <= most).all():  # so that what is no number is a reason, too
            return (
                f"the encoder of joint {(leap - most).max(axis=0).argmax() + 1} jumped"
            )
        off = np.abs(log.angles[log.last_answered] - log.expected[log.last_answered])
        if not off.max() <= self.astray:
            return f"joint {off.argmax() + 1} is {off.max():.2f} rad from where it was sent"
        return ""


def play(wire: Wire, log: MovementLog, guard: Guard, priority: int) -> None:
    """Send the log's velocities, each at its moment, and fill in what becomes of them.

    Raises HardwareError where `guard` finds a reason, after a ramp to rest, and
    KeyboardInterrupt, which the caller answers with the emergency stop.
    """
    tick = guard.arm.tick
    log.start = time.monotonic() + 2 * tick
    with real_time_priority(priority):
        for k in range(len(log.due)):
            due = log.start + k * tick
            _collect_answers(wire, log, due - SPIN_S)
            wait_until(due)
            # the emergency stop comes before anything else that is sent
            if guard.emergency_stop():
                wire.latch()
                raise HardwareError(
                    f"arm on {wire.name}: emergency stop ({guard.emergency_stop()})."
                )
            log.sent[k] = time.monotonic() - log.start
            number, log.speeds_sent[k] = wire.send(log.commanded[k])
            log.pending_ticks[number] = k
            reason = guard.stop_reason(log, k)
            if reason:
                _ramp_to_rest(wire, log, k, guard.arm, reason)
            log.last_checked = log.last_answered
        _collect_answers(wire, log, time.monotonic() + DRAIN_S)


def _collect_answers(wire: Wire, log: MovementLog, until: float) -> None:
    """Note the answers as they come, until all have come or the moment is there:
    looking once even when late.
    """
    while log.pending_ticks:
        for answer in wire.answers():
            _record_answer(log, answer)
        if time.monotonic() + POLL_S > until:
            break
        if log.pending_ticks:
            time.sleep(POLL_S)


def _record_answer(log: MovementLog, answer: ArmAnswer) -> None:
    at = log.pending_ticks.pop(answer.number, -1)
    if at < 0:  # a duplicate, or the answer to something else
        return
    log.acknowledged[at] = time.monotonic() - log.start
    log.device_time[at], log.angles[at] = answer.clock, answer.angles
    log.hold_reason = log.hold_reason or answer.hold_reason
    log.last_answered = max(log.last_answered, at)


def _ramp_to_rest(
    wire: Wire, log: MovementLog, tick: int, arm: Arm, reason: str
) -> None:
    """Slow to rest within the arm's acceleration, whether or not anybody answers, and
    say why.
    """
    speed = log.speeds_sent[tick]
    count = max(int(np.ceil(np.abs(speed / arm.acceleration).max() / arm.tick)), 1)
    try:
        for share in np.linspace(1, 0, count + 1)[1:]:
            wait_until(time.monotonic() + arm.tick)
            wire.send(speed * share)
    except HardwareError:
        reason += ", then the link went"
    wire.stop()
    raise HardwareError(
        f"arm on {wire.name}: {reason} at {log.due[tick]:.3f} s; it was brought to rest. "
        "Look at the arm, the cable and the device before the next try."
    )
