"""The loop: a velocity every tick on an absolute schedule, and every reason to stop looked at every tick."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stringcast.hardware.arm.clock import SPIN, undisturbed, wait_until
from stringcast.hardware.arm.wire import Answer, Wire
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

POLL = 0.0003  # [s] between looks for an answer
DRAIN = 0.05  # [s] that the last answers may take
NOISE = 0.02  # [rad] by which an encoder may be off from one answer to the next


@dataclass
class Log:
    """Arrays of every tick, reserved before the loop begins; NaN where nothing came."""

    due: np.ndarray
    asked: np.ndarray
    expected: np.ndarray
    sent: np.ndarray
    acknowledged: np.ndarray
    clock: np.ndarray
    carried: np.ndarray
    angles: np.ndarray
    begun: float = 0.0
    last: int = -1  # the latest tick that was answered
    judged: int = -1  # the latest when the guard last found nothing wrong
    held: str = ""
    waiting: dict[int, int] = field(default_factory=dict)  # ticks by the number of their command


def blank(start: np.ndarray, speeds: np.ndarray, tick: float) -> Log:
    """A log for velocities (K, J) [rad/s], played from the pose `start` (J,) [rad]."""
    count = len(speeds)
    turned = np.concatenate([np.zeros((1, len(start))), np.cumsum(speeds[:-1], axis=0) * tick])
    sent, acknowledged, clock = np.full((3, count), np.nan)
    carried, angles = np.full((2, *speeds.shape), np.nan)
    return Log(np.arange(count) * tick, speeds, start + turned, sent, acknowledged, clock, carried, angles)


@dataclass(frozen=True)
class Guard:
    """Limits whose violation ends a movement early.

    arm: its speed limits bound what an encoder can truly report. misses: unanswered ticks in a row that are
    borne. astray: largest distance from the commanded angles [rad]. pressed: the emergency stop, empty or a reason.
    """

    arm: Arm
    misses: int
    astray: float
    pressed: Callable[[], str]

    def reason(self, log: Log, tick: int) -> str:
        """Empty if all is well after sending `tick`."""
        silent = tick - 1 - log.last
        if silent > self.misses:
            return f"no answer for {silent} ticks"
        return log.held or self._wrong(log)

    def _wrong(self, log: Log) -> str:
        """The fault that the angles measured since the last look reveal; empty if none."""
        ticks = np.arange(max(log.judged, 0), log.last + 1)
        ticks = ticks[np.isfinite(log.clock[ticks])]  # several where this computer was late: each may show a jump
        if not np.isfinite(log.angles[ticks[ticks > log.judged]]).all():
            return "an encoder reports no number"
        if len(ticks) < 2:
            return ""
        leap = np.abs(np.diff(log.angles[ticks], axis=0)) - NOISE
        most = 2 * np.asarray(self.arm.speed) * np.maximum(np.diff(log.clock[ticks]), self.arm.tick)[:, None]
        if not (leap <= most).all():  # so that what is no number is a reason, too
            return f"the encoder of joint {(leap - most).max(axis=0).argmax() + 1} jumped"
        off = np.abs(log.angles[log.last] - log.expected[log.last])
        if not off.max() <= self.astray:
            return f"joint {off.argmax() + 1} is {off.max():.2f} rad from where it was sent"
        return ""


def play(wire: Wire, log: Log, guard: Guard, priority: int) -> None:
    """Send the log's velocities, each at its moment, and fill in what becomes of them.

    Raises HardwareError where `guard` finds a reason, after a ramp to rest, and KeyboardInterrupt, which the
    caller answers with the emergency stop.
    """
    tick = guard.arm.tick
    log.begun = time.monotonic() + 2 * tick
    with undisturbed(priority):
        for k in range(len(log.due)):
            due = log.begun + k * tick
            _listen(wire, log, due - SPIN)
            wait_until(due)
            if guard.pressed():  # the emergency stop comes before anything else that is sent
                wire.latch()
                raise HardwareError(f"arm on {wire.name}: emergency stop ({guard.pressed()}).")
            log.sent[k] = time.monotonic() - log.begun
            number, log.carried[k] = wire.send(log.asked[k])
            log.waiting[number] = k
            reason = guard.reason(log, k)
            if reason:
                _give_up(wire, log, k, guard.arm, reason)
            log.judged = log.last
        _listen(wire, log, time.monotonic() + DRAIN)


def _listen(wire: Wire, log: Log, until: float) -> None:
    """Note the answers as they come, until all have come or the moment is there: looking once even when late."""
    while log.waiting:
        for answer in wire.answers():
            _note(log, answer)
        if time.monotonic() + POLL > until:
            break
        if log.waiting:
            time.sleep(POLL)


def _note(log: Log, answer: Answer) -> None:
    at = log.waiting.pop(answer.number, -1)
    if at < 0:  # a duplicate, or the answer to something else
        return
    log.acknowledged[at] = time.monotonic() - log.begun
    log.clock[at], log.angles[at] = answer.clock, answer.angles
    log.held = log.held or answer.held
    log.last = max(log.last, at)


def _give_up(wire: Wire, log: Log, tick: int, arm: Arm, reason: str) -> None:
    """Slow to rest within the arm's acceleration, whether or not anybody answers, and say why."""
    speed = log.carried[tick]
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
