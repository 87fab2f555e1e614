"""The real arm: velocity commands every tick over a serial port, and nothing left moving."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType, TracebackType
from typing import Self

import numpy as np
import pandas as pd
import serial

from data.artifacts import JOINTS, SPEEDS
from hardware.serial.protocol import (
    PING,
    STOP,
    VELOCITY,
    Answer,
    Command,
    FrameError,
    decode_answer,
    encode_command,
)
from stages.model.arm import Arm
from stages.roles import HardwareError, Performance

PINGS = 50
ANSWER_WITHIN = 0.25  # [s] that a ping may take before the device is taken for dead
SPIN = 0.001  # [s] before a command is due from which the clock is watched closely
RAMP = 10  # ticks in which a faulty movement is brought to rest
START_TOLERANCE = 0.02  # [rad] between reported and commanded start
LIMIT_SLACK = 1.001  # limits may be touched to rounding


@dataclass
class SerialArm:
    """Fills `stages.roles.ArmDevice`.

    port: its device file. misses: unanswered ticks in a row after which the arm is stopped.
    late: lateness [s] above which a tick counts as missed; most_missed: share of missed
    ticks above which the trial is invalid. approach: speed [rad/s] of `move_to`; settle:
    time [s] for the string to come to rest.
    """

    arm: Arm
    port: str
    baud: int
    misses: int
    late: float
    most_missed: float
    approach: float
    settle: float
    sequence: int = 0
    buffer: bytearray = field(default_factory=bytearray)
    link: serial.Serial | None = None
    handlers: dict[int, Callable[[int, FrameType | None], object] | int | None] = field(default_factory=dict)

    def __enter__(self) -> Self:
        """Open the port and test the link; nothing moves."""
        check_latency(self.port)
        try:
            self.link = serial.Serial(self.port, self.baud, timeout=0, write_timeout=0.5, exclusive=True)
        except (serial.SerialException, OSError) as error:
            raise HardwareError(
                f"arm on {self.port}: cannot be opened ({error}). Check hardware.port and the cable."
            ) from error
        try:
            self._watch_signals()
            self._test_link()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop, whatever happened, and close."""
        if self.link is not None:
            for _ in range(3):
                self._try_stop()
            self.link.close()
            self.link = None
        for number, handler in self.handlers.items():
            signal.signal(number, handler)
        self.handlers.clear()

    def angles(self) -> np.ndarray:
        """Joint angles as the device reports them now, (J,) [rad]."""
        return np.array(self._exchange(PING).angles)

    def move_to(self, angles: Sequence[float]) -> None:
        """Go to joint angles with a smooth, slow movement, through the same checks as any other."""
        for _ in range(3):  # a velocity-driven joint ends a little off: go again from where it is
            here = self.angles()
            way = np.asarray(angles) - here
            if np.abs(way).max() < START_TOLERANCE / 4:
                break
            duration = max(np.abs(way).max() * np.pi / 2 / self.approach, 20 * self.arm.tick)
            ticks = int(np.ceil(duration / self.arm.tick))
            share = (1 - np.cos(np.pi * np.arange(ticks + 1) / ticks)) / 2
            self._checked_play(here + share[:, None] * way)
        time.sleep(self.settle)

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Check the whole movement, then play it."""
        angles = commands[list(JOINTS)].to_numpy()
        off = np.abs(self.angles() - angles[0]).max()
        if off > START_TOLERANCE:
            raise HardwareError(
                f"arm on {self.port}: it reports a pose {np.degrees(off):.1f} degrees from the movement's start. "
                "Move it there first (move_to), or check the encoders."
            )
        log, begun = self._checked_play(angles)
        return report(log, begun, float(commands["t"].iloc[0]), self.late, self.most_missed)

    def _checked_play(self, angles: np.ndarray) -> tuple[pd.DataFrame, float]:
        check_movement(self.arm, angles)
        return self._play(self.arm.commanded(angles))

    def _play(self, speeds: np.ndarray) -> tuple[pd.DataFrame, float]:
        """Send a velocity each tick on an absolute schedule; ramp down when answers stay out.

        Returns the log, and when the first velocity was due on the host's clock [s].
        """
        rows: dict[int, dict[str, float]] = {}
        sent: dict[int, int] = {}
        begin = time.monotonic() + 2 * self.arm.tick
        silent = 0
        for tick, speed in enumerate(speeds):
            due = begin + tick * self.arm.tick
            _wait_until(due)
            number = self._send(VELOCITY, tuple(speed))
            rows[tick] = _row(tick, due - begin, time.monotonic() - begin, speed)
            sent[number] = tick
            answered = self._collect(sent, rows, begin)
            silent = 0 if answered else silent + 1
            if silent > self.misses:
                self._ramp(speed)
                raise HardwareError(
                    f"arm on {self.port}: no answer for {silent} ticks at {due - begin:.3f} s; it was brought to rest. "
                    "Check the cable and the device."
                )
        self._drain(sent, rows, begin)
        self._exchange(STOP)
        return pd.DataFrame(list(rows.values())), begin

    def _ramp(self, speed: np.ndarray) -> None:
        """Slow to rest over a few ticks, whether or not anybody answers."""
        for share in np.linspace(1, 0, RAMP):
            self._send(VELOCITY, tuple(speed * share))
            time.sleep(self.arm.tick)
        self._try_stop()

    def _collect(self, sent: dict[int, int], rows: dict[int, dict[str, float]], begin: float) -> bool:
        """Take the answers that have come; True if there was one."""
        answers = self._answers()
        for answer in answers:
            if answer.sequence in sent:
                row = rows[sent.pop(answer.sequence)]
                row |= {"t_acknowledged": time.monotonic() - begin, "t_device": answer.clock}
                row |= dict(zip(JOINTS, answer.angles, strict=True))
        return bool(answers)

    def _drain(self, sent: dict[int, int], rows: dict[int, dict[str, float]], begin: float) -> None:
        """Wait a little for the last answers."""
        end = time.monotonic() + 0.05
        while sent and time.monotonic() < end:
            self._collect(sent, rows, begin)
            time.sleep(SPIN)

    def _test_link(self) -> None:
        """Round trips before anything moves; a slow link cannot carry a tick."""
        trips = []
        for _ in range(PINGS):
            begun = time.monotonic()
            self._exchange(PING)
            trips.append(time.monotonic() - begun)
        median, slow = np.percentile(trips, [50, 90])
        if median > self.arm.tick:
            raise HardwareError(
                f"arm on {self.port}: a round trip takes {median * 1e3:.1f} ms (90 %: {slow * 1e3:.1f} ms), a tick is "
                f"{self.arm.tick * 1e3:.0f} ms. Lower the adapter's latency timer to 1 ms or use another port."
            )

    def _exchange(self, kind: int) -> Answer:
        """Send and wait for the answer; asks again a few times, for a frame may be lost."""
        for _ in range(3):
            number = self._send(kind)
            end = time.monotonic() + ANSWER_WITHIN
            while time.monotonic() < end:
                for answer in self._answers():
                    if answer.sequence == number:
                        return answer
                time.sleep(0.0002)
        raise HardwareError(f"arm on {self.port}: the device does not answer. Is it switched on, and this its port?")

    def _send(self, kind: int, speeds: tuple[float, ...] = ()) -> int:
        assert self.link is not None
        self.sequence = (self.sequence + 1) % 2**16
        try:
            self.link.write(encode_command(Command(kind, self.sequence, speeds)))
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from error
        return self.sequence

    def _answers(self) -> list[Answer]:
        """Whole answers that have arrived; damaged ones are dropped."""
        assert self.link is not None
        try:
            self.buffer += self.link.read(4096)
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from error
        *frames, rest = bytes(self.buffer).split(b"\0")
        self.buffer = bytearray(rest)
        answers = []
        for frame in frames:
            try:
                answers.append(decode_answer(frame))
            except FrameError:
                continue
        return answers

    def _gone(self, error: Exception) -> HardwareError:
        return HardwareError(f"arm on {self.port}: the link is gone ({error}). The device's watchdog stops the arm.")

    def _try_stop(self) -> None:
        try:
            self._send(STOP)
        except HardwareError:
            return

    def _watch_signals(self) -> None:
        """A polite kill becomes an exception, so that the way out sends a stop. Only in the main thread."""

        def leave(number: int, frame: FrameType | None) -> None:
            raise KeyboardInterrupt

        try:
            self.handlers = {number: signal.signal(number, leave) for number in (signal.SIGTERM, signal.SIGHUP)}
        except ValueError:
            self.handlers = {}


def check_movement(arm: Arm, angles: np.ndarray) -> None:
    """Refuse a movement that leaves a limit anywhere. angles: (K, J) on the tick [rad]."""
    speeds = arm.commanded(angles)
    change = np.diff(speeds, axis=0, prepend=0.0) / arm.tick
    hand = np.linalg.norm(arm.grasp_velocity(angles, speeds)[:, :2], axis=1)
    checks = {
        "arm.lowest or arm.highest (range)": ((angles < arm.lowest) | (angles > arm.highest)).any(axis=1),
        "arm.speed": (np.abs(speeds) > LIMIT_SLACK * np.asarray(arm.speed)).any(axis=1),
        "arm.hand_speed": hand > LIMIT_SLACK * arm.hand_speed,
        "arm.acceleration": (np.abs(change) > LIMIT_SLACK * np.asarray(arm.acceleration)).any(axis=1),
    }
    for limit, bad in checks.items():
        if bad.any():
            at = float(np.argmax(bad)) * arm.tick
            raise HardwareError(
                f"arm: the movement leaves {limit} at {at:.3f} s; nothing was moved. Choose another motion."
            )


def check_latency(port: str) -> None:
    """Refuse an FTDI adapter that holds bytes back for longer than 1 ms."""
    timer = Path("/sys/bus/usb-serial/devices") / Path(port).name / "latency_timer"
    if timer.exists() and int(timer.read_text()) > 1:
        raise HardwareError(
            f"arm on {port}: the adapter's latency timer is {timer.read_text().strip()} ms; a 5 ms loop needs 1. "
            f"Run: echo 1 | sudo tee {timer}"
        )


def report(log: pd.DataFrame, begun: float, start: float, late: float, most_missed: float) -> Performance:
    """Tables of a performance; times shifted so that the movement starts at 0."""
    lateness = (log["t_sent"] - log["t_due"]).to_numpy()
    missed = (lateness > late) | log["t_acknowledged"].isna().to_numpy()
    share = missed.mean()
    reason = f"{share:.1%} of the ticks were late or lost, allowed are {most_missed:.1%}" if share > most_missed else ""
    p50, p99 = np.percentile(lateness, [50, 99])
    link = {"valid": not reason, "reason": reason, "ticks": len(log), "missed": int(missed.sum())}
    link |= {"jitter_p50": p50, "jitter_p99": p99, "jitter_max": lateness.max()}
    moments = log[["t_due", "t_sent", "t_acknowledged"]] + start
    ticks = log.assign(**{name: moments[name] for name in moments}, missed=missed)
    known = ticks.dropna(subset=["t_acknowledged"])
    # The device measures when a command reaches it: between sending and acknowledgement.
    arm = known[list(JOINTS)].assign(t=known["t_sent"]).sort_values("t").drop_duplicates("t")
    return Performance(arm[["t", *JOINTS]].reset_index(drop=True), ticks, pd.DataFrame([link]), begun)


def _row(tick: int, due: float, sent: float, speed: np.ndarray) -> dict[str, float]:
    nothing = dict.fromkeys(("t_acknowledged", "t_device", *JOINTS), np.nan)
    return {"tick": tick, "t_due": due, "t_sent": sent} | dict(zip(SPEEDS, speed, strict=True)) | nothing


def _wait_until(moment: float) -> None:
    """Sleep, then watch the clock: a sleep alone wakes up late."""
    rest = moment - time.monotonic() - SPIN
    if rest > 0:
        time.sleep(rest)
    while time.monotonic() < moment:
        pass
