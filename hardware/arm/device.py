"""The real arm: velocity commands every tick, and nothing left moving."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Annotated, Self

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS
from stringcast.hardware.arm.limits import Workspace, check_movement
from stringcast.hardware.arm.loop import Guard, MovementLog, play, reserve_log
from stringcast.hardware.arm.record import build_performance
from stringcast.hardware.arm.signals import TerminationSignals
from stringcast.hardware.arm.wire import Wire
from stringcast.stages.execute.interfaces import HardwareError, Performance
from stringcast.stages.model.arm import Arm

LINK_TEST_TRIPS = 50  # round trips of the link test
START_TOLERANCE_RAD = 0.02  # [rad] between reported and commanded start


@dataclass(frozen=True)
class Driving:
    """Settings by which an arm is driven.

    round_trip: median of the link test [s] above which nothing moves. misses:
    unanswered ticks in a row after which it is brought to rest. late: lateness [s]
    above which a tick counts as missed; most_missed: share of missed ticks above which
    the trial is invalid. astray: distance from the commanded angles [rad] at which it
    is brought to rest. approach: speed [rad/s] of `move_to`; settle: time [s] for the
    string to come to rest. priority: SCHED_FIFO, 1 to 99, where the system allows it;
    0: as usual. workspace: where joints and hand may be.
    """

    round_trip: Annotated[float, Field(gt=0)]
    misses: Annotated[int, Field(ge=1)]
    late: Annotated[float, Field(gt=0)]
    most_missed: Annotated[float, Field(ge=0, le=1)]
    astray: Annotated[float, Field(gt=0)]
    approach: Annotated[float, Field(gt=0)]
    settle: Annotated[float, Field(ge=0)]
    priority: Annotated[int, Field(ge=0, le=99)]
    workspace: Workspace


@dataclass
class VelocityArm:
    """Fills `stages.execute.interfaces.ArmDevice` over any wire.

    latched: why the emergency stop was pressed; empty if it was not. Nothing moves
    until `clear`.
    """

    arm: Arm
    wire: Wire
    driving: Driving
    latch_reason: str = ""
    is_moving: bool = False
    round_trips_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    signals: TerminationSignals = field(default_factory=TerminationSignals)

    def __enter__(self) -> Self:
        """Connect and test the link; nothing moves."""
        self.signals.install()
        try:
            self.wire.open()
            self.wire.set_limits(self.arm)
            self._test_link()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop, whatever happened, and let go. A movement that did not come to its end
        is an emergency.
        """
        # from the last to the first, each whatever becomes of those before
        with ExitStack() as ways:
            ways.callback(self.signals.restore)
            ways.enter_context(self.signals.ignore())
            ways.callback(self.wire.close)
            ways.callback(self.wire.stop)
            if self.is_moving or self.latch_reason:
                ways.callback(self.wire.latch)

    def press_emergency_stop(self, reason: str) -> None:
        """The emergency stop, from any thread: obeyed within a tick, and latched here
        and in the device.
        """
        self.latch_reason = reason

    def clear(self) -> None:
        """Undo the emergency stop on purpose, after a person has looked at the arm."""
        self.wire.clear()
        self.wire.set_limits(self.arm)
        self.latch_reason = ""

    def angles(self) -> np.ndarray:
        """Joint angles as the device reports them now, (J,) [rad]."""
        here = np.array(self.wire.angles())
        if not np.isfinite(here).all():
            raise HardwareError(
                f"arm on {self.wire.name}: an encoder reports no number. Look at it before the next try."
            )
        return here

    def move_to(self, angles: Sequence[float]) -> None:
        """Go to joint angles with a smooth, slow movement, through the same checks as
        any other.
        """
        # a velocity-driven joint ends a little off: go again from where it is
        for _ in range(3):
            here = self.angles()
            way = np.asarray(angles) - here
            if np.abs(way).max() < START_TOLERANCE_RAD / 4:
                break
            # half a cosine is pi / 2 times as fast in its middle as on average
            duration = max(
                np.abs(way).max() * np.pi / 2 / self.driving.approach,
                20 * self.arm.tick,
            )
            ticks = int(np.ceil(duration / self.arm.tick))
            share = (1 - np.cos(np.pi * np.arange(ticks + 1) / ticks)) / 2
            self._check_and_play(here + share[:, None] * way)
        time.sleep(self.driving.settle)

    def check(self, commands: pd.DataFrame) -> None:
        """The whole movement against the arm's limits."""
        check_movement(
            self.arm, self.driving.workspace, commands[list(JOINTS)].to_numpy()
        )

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Check the whole movement, then play it."""
        self._refuse_latched()
        angles = commands[list(JOINTS)].to_numpy()
        off = np.abs(self.angles() - angles[0]).max()
        if not off <= START_TOLERANCE_RAD:
            raise HardwareError(
                f"arm on {self.wire.name}: it reports a pose {np.degrees(off):.1f} degrees from the movement's start. "
                "Move it there first (move_to), or check the encoders."
            )
        log = self._check_and_play(angles)
        start = float(commands["t"].iloc[0])
        return build_performance(
            log, start, self.driving.late, self.driving.most_missed, self.round_trips_s
        )

    def _check_and_play(self, angles: np.ndarray) -> MovementLog:
        self._refuse_latched()
        check_movement(self.arm, self.driving.workspace, angles)
        log = reserve_log(
            angles[0], self.arm.commanded_velocities(angles), self.arm.tick
        )
        self.is_moving = True
        try:
            guard = Guard(
                self.arm,
                self.driving.misses,
                self.driving.astray,
                lambda: self.latch_reason,
            )
            play(self.wire, log, guard, self.driving.priority)
        except HardwareError:
            # ramped to rest; on a dead link its watchdog does that, and leaving sends a
            # stop
            self.is_moving = False
            raise
        self.wire.stop()
        self.is_moving = False
        return log

    def _refuse_latched(self) -> None:
        if self.latch_reason:
            raise HardwareError(
                f"arm on {self.wire.name}: latched by the emergency stop ({self.latch_reason}). "
                "Look why, make it safe, then clear it."
            )

    def _test_link(self) -> None:
        """Round trips before anything moves: a slow link cannot carry a tick, nor a
        fast one a hasty watchdog.
        """
        trips = []
        for _ in range(LINK_TEST_TRIPS):
            begun = time.monotonic()
            self.wire.angles()
            trips.append(time.monotonic() - begun)
        self.round_trips_s = np.array(trips)
        if not np.median(self.round_trips_s) <= self.driving.round_trip:
            p50, p99, most = np.percentile(self.round_trips_s, [50, 99, 100]) * 1e3
            raise HardwareError(
                f"arm on {self.wire.name}: a round trip takes {p50:.1f} ms (99 %: {p99:.1f}, longest: {most:.1f} ms), "
                f"allowed are {self.driving.round_trip * 1e3:.1f}. Lower the adapter's latency timer, or change ports."
            )
        if not self.wire.watchdog >= 2 * self.arm.tick:
            raise HardwareError(
                f"arm on {self.wire.name}: its watchdog of {self.wire.watchdog * 1e3:.0f} ms is shorter than two "
                "ticks. Lengthen it in the device."
            )
