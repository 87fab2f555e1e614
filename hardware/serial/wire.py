"""The host's side of the link, specified in hardware/serial/README.md."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.hardware.arm.wire import ArmAnswer
from stringcast.hardware.serial.protocol import (
    JOINT_COUNT,
    PROTOCOL_VERSION,
    Command,
    Deframer,
    DeviceAnswer,
    DeviceState,
    FrameError,
    FrameKind,
    Greeting,
    LimitsAnswer,
    Report,
    decode_answer,
    encode_command,
)
from stringcast.stages.execute.interfaces import HardwareError
from stringcast.stages.model.arm import Arm

serial = LazyModule("serial")

ANSWER_TIMEOUT_S = 0.25  # [s] before an exchange is repeated
# repetitions of a frame, as a disturbed line loses single ones
MAX_TRIES = 3
HOLD_REASONS = {
    DeviceState.FRESH: "the device restarted",
    DeviceState.TRIPPED: "the device's watchdog stopped it",
    DeviceState.LATCHED: "the device is latched",
    DeviceState.CLAMPED: "the device cut a velocity that was beyond its limits",
}
# all other kinds are answered by a Report
ANSWER_TYPES = {FrameKind.HELLO: Greeting, FrameKind.LIMITS: LimitsAnswer}
# margin for rounding; the host keeps the exact limits
LIMIT_MARGIN = 1.01


@dataclass
class SerialWire:
    """A serial port; implements `hardware.arm.wire.Wire`.

    Attributes
    ----------
    port
        Its device file.
    sequence
        Number of the last command.
    last_refusal
        The fault of the last unusable answer.
    clock_us
        The device's clock as last reported, unwrapped [us].
    """

    port: str
    baud: int
    sequence: int = 0
    watchdog: float = 0.0
    link: Any = None
    deframer: Deframer = field(default_factory=Deframer)
    last_refusal: str = ""
    clock_us: int | None = None

    def open(self) -> None:
        """Open the port and greet the device."""
        self._connect()
        greeting = self._exchange(FrameKind.HELLO, (PROTOCOL_VERSION,))
        assert isinstance(greeting, Greeting)
        if (greeting.version, greeting.joints) != (PROTOCOL_VERSION, JOINT_COUNT):
            raise HardwareError(
                f"arm on {self.port}",
                f"the device speaks version {greeting.version} for "
                f"{greeting.joints} joints, this is version {PROTOCOL_VERSION} "
                f"for {JOINT_COUNT}",
                "Update the older one (hardware/serial/README.md).",
            )
        if greeting.state is DeviceState.LATCHED:
            raise HardwareError(
                f"arm on {self.port}",
                "latched by an emergency stop",
                "Look why, make it safe, then: python -m "
                f"stringcast.hardware.serial.clear {self.port}",
            )
        self.watchdog = greeting.watchdog * 1e-3

    def set_limits(self, arm: Arm) -> None:
        """Send LIMITS, with the watchdog of the device's greeting."""
        limits = np.array([*arm.speed, *arm.acceleration], dtype=np.float32)
        tick, watchdog = round(arm.tick * 1e6), round(self.watchdog * 1e3)
        wanted = (*map(float, LIMIT_MARGIN * limits), tick, watchdog)
        answer = self._exchange(FrameKind.LIMITS, wanted)
        assert isinstance(answer, LimitsAnswer)
        if answer.values != wanted:
            raise HardwareError(
                f"arm on {self.port}",
                f"the device does not enforce the limits of conf/arm, {wanted}, "
                f"but {answer.values}",
                "See what it can (hardware/serial/README.md).",
            )

    def close(self) -> None:
        """Close the serial port if it is open."""
        if self.link is not None:
            self.link.close()
            self.link = None

    def angles(self) -> tuple[float, ...]:
        """Measure the joint angles (J,) [rad] by a ping."""
        return self._report(FrameKind.PING).angles

    def send(self, speeds: np.ndarray) -> tuple[int, np.ndarray]:
        """Send velocities (J,) [rad/s] in single precision.

        Returns number and sent velocities of the command.
        """
        rounded = speeds.astype(np.float32)
        return self._send(FrameKind.VELOCITY, tuple(rounded)), rounded

    def answers(self) -> Sequence[ArmAnswer]:
        """Return the arrived reports, without damaged frames."""
        answers = []
        for report in self._read_answers():
            if isinstance(report, Report):
                clock = self._unwrap_clock(report.micros)
                reason = HOLD_REASONS.get(report.state, "")
                answers.append(ArmAnswer(report.sequence, clock, reason, report.angles))
        return answers

    def stop(self) -> None:
        """Send STOP three times, as frames may be lost, and wait for an answer."""
        with suppress(HardwareError):  # no device answers: its watchdog trips
            for _ in range(MAX_TRIES):
                self._send(FrameKind.STOP)
            self._report(FrameKind.STOP)

    def latch(self) -> None:
        """Send LATCH three times, as frames may be lost."""
        with suppress(HardwareError):
            for _ in range(MAX_TRIES):
                self._send(FrameKind.LATCH)

    def clear(self) -> None:
        """Clear the emergency stop; connect first if the port is not open."""
        if self.link is None:
            self._connect()
        self._report(FrameKind.CLEAR)
        self._exchange(FrameKind.HELLO, (PROTOCOL_VERSION,))

    def _connect(self) -> None:
        check_latency(self.port)
        try:
            self.link = serial.Serial(
                self.port, self.baud, timeout=0, write_timeout=0.5, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise HardwareError(
                f"arm on {self.port}",
                f"cannot be opened ({error})",
                "Check hardware.port and the cable.",
            ) from error

    def _unwrap_clock(self, micros: int) -> float:
        """Return the device time [s] from its clock of 32 bits.

        It wraps every 72 minutes, and answers may be reordered.
        """
        last = micros if self.clock_us is None else self.clock_us
        step = (micros - last + 2**31) % 2**32 - 2**31
        self.clock_us = last + step
        return self.clock_us * 1e-6

    def _report(self, kind: FrameKind) -> Report:
        report = self._exchange(kind)
        assert isinstance(report, Report)
        return report

    def _exchange(
        self, kind: FrameKind, values: tuple[float, ...] = ()
    ) -> DeviceAnswer:
        """Send and wait for the answer; repeat if a frame is lost."""
        expected = ANSWER_TYPES.get(kind, Report)
        for _ in range(MAX_TRIES):
            number = self._send(kind, values)
            end = time.monotonic() + ANSWER_TIMEOUT_S
            while time.monotonic() < end:
                for answer in self._read_answers():
                    if answer.sequence == number and isinstance(answer, expected):
                        return answer
                time.sleep(0.0002)
        refusal = ""
        if self.last_refusal:
            refusal = f" with anything that can be used ({self.last_refusal})"
        raise HardwareError(
            f"arm on {self.port}",
            f"the device does not answer{refusal}",
            "Is it switched on, and this its port?",
        )

    def _send(self, kind: FrameKind, values: tuple[float, ...] = ()) -> int:
        if self.link is None:
            raise HardwareError(f"arm on {self.port}", "it is not open")
        self.sequence = (self.sequence + 1) % 2**16
        try:
            self.link.write(encode_command(Command(kind, self.sequence, values)))
        except (serial.SerialException, OSError) as error:
            raise self._link_error(error) from error
        return self.sequence

    def _read_answers(self) -> list[DeviceAnswer]:
        """Return the completed answers."""
        assert self.link is not None
        try:
            data = self.link.read(4096)
        # TypeError: port closed during the call
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._link_error(error) from error
        answers = []
        for frame in self.deframer.frames(data):
            try:
                answers.append(decode_answer(frame))
            except FrameError as error:
                self.last_refusal = str(error)
        return answers

    def _link_error(self, error: Exception) -> HardwareError:
        return HardwareError(
            f"arm on {self.port}",
            f"the link is gone ({error})",
            "The device's watchdog stops the arm.",
        )


def check_latency(
    port: str, devices: Path = Path("/sys/bus/usb-serial/devices")
) -> None:
    """Refuse an FTDI adapter with a latency timer above 1 ms."""
    timer = devices / Path(port).resolve().name / "latency_timer"
    if timer.exists() and int(timer.read_text()) > 1:
        raise HardwareError(
            f"arm on {port}",
            f"the adapter's latency timer is {timer.read_text().strip()} ms; a 5 "
            "ms loop needs 1",
            f"Run: echo 1 | sudo tee {timer}",
        )
