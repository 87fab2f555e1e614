"""The loop that sends a velocity every tick on an absolute schedule.

At every tick it checks each reason to stop.
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

POLL_S = 0.0003  # [s] between polls for an answer
DRAIN_S = 0.05  # [s] to wait for the last answers
# [rad] of encoder error between two answers
ENCODER_NOISE_RAD = 0.02


@dataclass
class MovementLog:
    """The record of every tick, allocated before the loop starts.

    Attributes
    ----------
    due : (K,)
        Due time of each command from the start [s].
    commanded : (K, J)
        Velocities [rad/s].
    expected : (K, J)
        Integrated velocities [rad].
    sent, acknowledged : (K,)
        Times of sending and of acknowledgement [s]; NaN without.
    device_time : (K,)
        The device's clock in each answer [s].
    speeds_sent : (K, J)
        Velocities as encoded for the link [rad/s].
    angles : (K, J)
        Measured angles in each answer [rad].
    start
        Host time of the first tick (time.monotonic) [s].
    last_answered
        The latest answered tick; -1 for none.
    last_checked
        `last_answered` when the guard last found no fault.
    hold_reason
        Why the device ignores commands; empty if it does not.
    pending_ticks
        Unanswered ticks by the number of their command.
    """

    due: np.ndarray
    commanded: np.ndarray
    expected: np.ndarray
    sent: np.ndarray
    acknowledged: np.ndarray
    device_time: np.ndarray
    speeds_sent: np.ndarray
    angles: np.ndarray
    start: float = 0.0
    last_answered: int = -1
    last_checked: int = -1
    hold_reason: str = ""
    pending_ticks: dict[int, int] = field(default_factory=dict)


def reserve_log(start: np.ndarray, speeds: np.ndarray, tick: float) -> MovementLog:
    """Allocate a log for velocities (K, J) [rad/s] from the pose `start` (J,) [rad]."""
    count = len(speeds)
    turned = np.zeros(speeds.shape)
    turned[1:] = np.cumsum(speeds[:-1], axis=0) * tick
    due = np.arange(count) * tick
    sent, acknowledged, device_time = np.full((3, count), np.nan)
    speeds_sent, angles = np.full((2, *speeds.shape), np.nan)
    times = sent, acknowledged, device_time
    return MovementLog(due, speeds, start + turned, *times, speeds_sent, angles)


@dataclass(frozen=True)
class Guard:
    """Limits whose violation ends a movement early.

    Attributes
    ----------
    arm
        The arm; its speed limits bound plausible encoder readings.
    misses
        Unanswered ticks in a row that are tolerated.
    astray
        Largest distance from the commanded angles [rad].
    emergency_stop
        Returns the reason of the emergency stop; empty if not pressed.
    """

    arm: Arm
    misses: int
    astray: float
    emergency_stop: Callable[[], str]

    def stop_reason(self, log: MovementLog, tick: int) -> str:
        """Return the reason to end the movement at `tick`; empty for none."""
        silent = tick - 1 - log.last_answered
        if silent > self.misses:
            return f"no answer for {silent} ticks"
        return log.hold_reason or self._angle_fault(log)

    def _angle_fault(self, log: MovementLog) -> str:
        """Describe a fault in the angles measured since the last check.

        NaN is a fault, too.
        """
        ticks = np.arange(max(log.last_checked, 0), log.last_answered + 1)
        # several if this computer was late; each may show a jump
        ticks = ticks[np.isfinite(log.device_time[ticks])]
        if not np.isfinite(log.angles[ticks[ticks > log.last_checked]]).all():
            return "an encoder reports no number"
        if len(ticks) < 2:
            return ""
        steps = np.maximum(np.diff(log.device_time[ticks]), self.arm.tick)
        jump = np.abs(np.diff(log.angles[ticks], axis=0)) - ENCODER_NOISE_RAD
        max_jump = 2 * np.asarray(self.arm.speed) * steps[:, None]
        if not (jump <= max_jump).all():
            joint = (jump - max_jump).max(axis=0).argmax() + 1
            return f"the encoder of joint {joint} jumped"
        last = log.last_answered
        offset = np.abs(log.angles[last] - log.expected[last])
        if not offset.max() <= self.astray:
            joint = offset.argmax() + 1
            return f"joint {joint} is {offset.max():.2f} rad from where it was sent"
        return ""


def play(wire: Wire, log: MovementLog, guard: Guard, priority: int) -> None:
    """Send each velocity of the log when it is due, and record the answers.

    Parameters
    ----------
    wire
        The open link to the arm.
    log
        The velocities; the answers are recorded in it.
    guard
        The limits that end the movement early.
    priority
        Real-time priority, 1 to 99; 0: normal.

    Raises
    ------
    HardwareError
        If `guard` finds a reason to stop, after a ramp to rest.
    KeyboardInterrupt
        If the user interrupts; the caller answers with the emergency stop.
    """
    tick = guard.arm.tick
    log.start = time.monotonic() + 2 * tick
    with real_time_priority(priority):
        for k in range(len(log.due)):
            due = log.start + k * tick
            _collect_answers(wire, log, due - SPIN_S)
            wait_until(due)
            # check the emergency stop before sending
            pressed = guard.emergency_stop()
            if pressed:
                wire.latch()
                raise HardwareError(
                    f"arm on {wire.port}", f"emergency stop ({pressed})"
                )
            log.sent[k] = time.monotonic() - log.start
            number, log.speeds_sent[k] = wire.send(log.commanded[k])
            log.pending_ticks[number] = k
            reason = guard.stop_reason(log, k)
            if reason:
                _ramp_to_rest(wire, log, k, guard.arm, reason)
            log.last_checked = log.last_answered
        _collect_answers(wire, log, time.monotonic() + DRAIN_S)


def _collect_answers(wire: Wire, log: MovementLog, deadline: float) -> None:
    """Record answers until all have arrived or the deadline has passed.

    It polls at least once.
    """
    while log.pending_ticks:
        for answer in wire.answers():
            _record_answer(log, answer)
        if time.monotonic() + POLL_S > deadline:
            break
        if log.pending_ticks:
            time.sleep(POLL_S)


def _record_answer(log: MovementLog, answer: ArmAnswer) -> None:
    tick = log.pending_ticks.pop(answer.number, -1)
    if tick < 0:  # a duplicate, or an answer to another command
        return
    log.acknowledged[tick] = time.monotonic() - log.start
    log.device_time[tick], log.angles[tick] = answer.clock, answer.angles
    log.hold_reason = log.hold_reason or answer.hold_reason
    log.last_answered = max(log.last_answered, tick)


def _ramp_to_rest(
    wire: Wire, log: MovementLog, tick: int, arm: Arm, reason: str
) -> None:
    """Ramp to rest within the arm's acceleration, then raise the reason."""
    speed = log.speeds_sent[tick]
    duration = np.abs(speed / arm.acceleration).max()
    count = max(int(np.ceil(duration / arm.tick)), 1)
    try:
        for fraction in np.linspace(1, 0, count + 1)[1:]:
            wait_until(time.monotonic() + arm.tick)
            wire.send(speed * fraction)
    except HardwareError:
        reason += ", then the link went"
    wire.stop()
    raise HardwareError(
        f"arm on {wire.port}",
        f"{reason} at {log.due[tick]:.3f} s; it was brought to rest",
        "Look at the arm, the cable and the device before the next try.",
    )
