"""The real arm: velocity commands every tick, and a stop on every exit."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

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
MAX_APPROACHES = 3  # movements to the start, each starting nearer
MIN_APPROACH_TICKS = 20  # of the shortest movement to the start


@dataclass(frozen=True)
class Driving:
    """Settings of the arm driver.

    Attributes
    ----------
    round_trip
        Median round trip above which the arm is not moved [s].
    misses
        Unanswered ticks in a row after which the arm is brought to rest.
    late
        Lateness above which a tick counts as missed [s].
    most_missed
        Fraction of missed ticks above which the trial is invalid.
    astray
        Distance from the commanded angles at which the arm is brought to rest [rad].
    approach
        Speed of `move_to` [rad/s].
    settle
        Time for the string to come to rest [s].
    priority
        SCHED_FIFO, 1 to 99, if the system allows it; 0: normal.
    workspace
        The region for joints and hand.
    """

    round_trip: PositiveFloat
    misses: PositiveInt
    late: PositiveFloat
    most_missed: Annotated[float, Field(ge=0, le=1)]
    astray: PositiveFloat
    approach: PositiveFloat
    settle: NonNegativeFloat
    priority: Annotated[int, Field(ge=0, le=99)]
    workspace: Workspace


@dataclass
class VelocityArm:
    """An arm on any wire; implements `ArmDevice` of `stages.execute`.

    Attributes
    ----------
    arm
        The arm with its limits.
    wire
        The link to it.
    driving
        Settings of the driver.
    latch_reason
        Reason of the emergency stop; empty if not pressed. Nothing moves until `clear`.
    is_moving
        Whether a movement is in progress or was ended early.
    round_trips_s : (N,)
        Round trips of the link test [s].
    signals
        The signals that end a movement.
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
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the arm in any case, and close the link.

        An incomplete movement is an emergency.
        """
        # run in reverse order, each even if another fails
        with ExitStack() as stack:
            stack.callback(self.signals.restore)
            stack.enter_context(self.signals.ignore())
            stack.callback(self.wire.close)
            stack.callback(self.wire.stop)
            if self.is_moving or self.latch_reason:
                stack.callback(self.wire.latch)

    def press_emergency_stop(self, reason: str) -> None:
        """Press the emergency stop, from any thread.

        It takes effect within a tick, and is latched here and in the device.
        """
        self.latch_reason = reason

    def clear(self) -> None:
        """Clear the emergency stop after a person has checked the arm."""
        self.wire.clear()
        self.wire.set_limits(self.arm)
        self.latch_reason = ""

    def angles(self) -> np.ndarray:
        """Measure the joint angles now.

        Returns
        -------
        (J,) ndarray
            Joint angles [rad].

        Raises
        ------
        HardwareError
            If an encoder reports no number.
        """
        angles = np.array(self.wire.angles())
        if not np.isfinite(angles).all():
            raise HardwareError(
                f"arm on {self.wire.port}",
                "an encoder reports no number",
                "Look at it before the next try.",
            )
        return angles

    def move_to(self, angles: Sequence[float]) -> None:
        """Move slowly and smoothly to joint angles, with the checks of any movement.

        Parameters
        ----------
        angles : (J,)
            Joint angles [rad].

        Raises
        ------
        HardwareError
            If a limit would be left or the arm does not follow.
        """
        # a velocity-driven joint ends slightly off: repeat from there
        for _ in range(MAX_APPROACHES):
            start = self.angles()
            distance = np.asarray(angles) - start
            farthest = np.abs(distance).max()
            if farthest < START_TOLERANCE_RAD / 4:
                break
            # the peak speed of half a cosine is pi / 2 times its mean
            duration = farthest * np.pi / 2 / self.driving.approach
            duration = max(duration, MIN_APPROACH_TICKS * self.arm.tick)
            ticks = int(np.ceil(duration / self.arm.tick))
            share = (1 - np.cos(np.pi * np.arange(ticks + 1) / ticks)) / 2
            self._check_and_play(start + share[:, None] * distance)
        time.sleep(self.driving.settle)

    def check(self, commands: pd.DataFrame) -> None:
        """Refuse a movement that leaves a limit; nothing moves.

        Parameters
        ----------
        commands
            Table COMMANDS.

        Raises
        ------
        HardwareError
            If a limit is left anywhere.
        """
        angles = commands[list(JOINTS)].to_numpy()
        check_movement(self.arm, self.driving.workspace, angles)

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Check the whole movement, then play it.

        Parameters
        ----------
        commands
            Table COMMANDS.

        Returns
        -------
        Performance
            The measured movement and its timing.

        Raises
        ------
        HardwareError
            If the arm is latched or elsewhere, a limit would be left, or the movement
            had to be ended.
        """
        self._refuse_latched()
        angles = commands[list(JOINTS)].to_numpy()
        offset = np.abs(self.angles() - angles[0]).max()
        if not offset <= START_TOLERANCE_RAD:
            raise HardwareError(
                f"arm on {self.wire.port}",
                f"it reports a pose {np.degrees(offset):.1f} degrees from the "
                "movement's start",
                "Move it there first (move_to), or check the encoders.",
            )
        log = self._check_and_play(angles)
        return build_performance(
            log,
            float(commands["t"].iloc[0]),
            self.driving.late,
            self.driving.most_missed,
            self.round_trips_s,
        )

    def _check_and_play(self, angles: np.ndarray) -> MovementLog:
        self._refuse_latched()
        check_movement(self.arm, self.driving.workspace, angles)
        speeds = self.arm.commanded_velocities(angles)
        log = reserve_log(angles[0], speeds, self.arm.tick)
        driving = self.driving
        guard = Guard(
            self.arm, driving.misses, driving.astray, lambda: self.latch_reason
        )
        self.is_moving = True
        try:
            play(self.wire, log, guard, driving.priority)
        except HardwareError:
            # The arm was ramped to rest, on a dead link by the watchdog. `__exit__`
            # sends a stop.
            self.is_moving = False
            raise
        self.wire.stop()
        self.is_moving = False
        return log

    def _refuse_latched(self) -> None:
        if self.latch_reason:
            raise HardwareError(
                f"arm on {self.wire.port}",
                f"latched by the emergency stop ({self.latch_reason})",
                "Look why, make it safe, then clear it.",
            )

    def _test_link(self) -> None:
        """Measure round trips before anything moves, and check the watchdog.

        A slow link misses ticks, and a short watchdog trips at a late one.
        """
        trips = []
        for _ in range(LINK_TEST_TRIPS):
            start = time.monotonic()
            self.wire.angles()
            trips.append(time.monotonic() - start)
        self.round_trips_s = np.array(trips)
        if not np.median(self.round_trips_s) <= self.driving.round_trip:
            p50, p99, longest = np.percentile(self.round_trips_s, [50, 99, 100]) * 1e3
            raise HardwareError(
                f"arm on {self.wire.port}",
                f"a round trip takes {p50:.1f} ms (99 %: {p99:.1f}, longest: "
                f"{longest:.1f} ms), allowed are "
                f"{self.driving.round_trip * 1e3:.1f}",
                "Lower the adapter's latency timer, or change ports.",
            )
        if not self.wire.watchdog >= 2 * self.arm.tick:
            raise HardwareError(
                f"arm on {self.wire.port}",
                f"its watchdog of {self.wire.watchdog * 1e3:.0f} ms is "
                "shorter than two ticks",
                "Lengthen it in the device.",
            )
