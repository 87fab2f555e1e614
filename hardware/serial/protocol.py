"""Frames on the wire: COBS, CRC-32, sequence numbers. Specification in README.md beside
this file.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

PROTOCOL_VERSION = 3  # of the protocol: device and driver must have the same
JOINT_COUNT = 3  # whose velocities a command carries
MAX_FRAME_BYTES = 64  # bytes between two delimiters; more cannot be a frame


class FrameKind(IntEnum):
    """The kind of a frame. Host to device below 0x80, device to host above."""

    PING = 0x01
    VELOCITY = 0x02
    STOP = 0x03
    LATCH = 0x04
    CLEAR = 0x05
    HELLO = 0x06
    LIMITS = 0x07
    ANSWER = 0x81
    GREETING = 0x82
    LIMITED = 0x83


class DeviceState(IntEnum):
    """The state of the device."""

    FRESH = 0  # just switched on: obeys HELLO only
    IDLE = 1  # at rest, ready
    MOVING = 2  # follows velocities; the watchdog is armed
    TRIPPED = 3  # the watchdog brought it to rest: obeys HELLO only
    LATCHED = 4  # emergency stop: obeys CLEAR only
    CLAMPED = 5  # as MOVING, but a velocity was beyond the limits and was cut to them


_HEAD = struct.Struct("<BH")
_LIMITS = struct.Struct(f"<{2 * JOINT_COUNT}fHH")
_BODIES = {
    FrameKind.VELOCITY: struct.Struct(f"<{JOINT_COUNT}f"),
    FrameKind.HELLO: struct.Struct("<B"),
    FrameKind.LIMITS: _LIMITS,
}
_NONE = struct.Struct("")
_ANSWER = struct.Struct(f"<IB{JOINT_COUNT}f")
_GREETING = struct.Struct("<BBHB")


class FrameError(Exception):
    """Bytes that are no whole frame of ours."""


@dataclass(frozen=True, slots=True)
class Command:
    """Host to device. values: speeds [rad/s] of VELOCITY, the host's version of HELLO,
    those of `Limits` of LIMITS, else nothing.
    """

    kind: FrameKind
    sequence: int
    values: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """Device to host. micros: device clock [us], wraps at 2^32. angles: measured [rad]."""

    sequence: int
    micros: int
    state: DeviceState
    angles: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Greeting:
    """The device's answer to HELLO. watchdog [ms]."""

    sequence: int
    version: int
    joints: int
    watchdog: int
    state: DeviceState


@dataclass(frozen=True, slots=True)
class LimitsAnswer:
    """Limits that the device enforces by itself: its answer to LIMITS. values: largest
    speed [rad/s] and acceleration [rad/s^2] of each joint, the host's tick [us], the
    watchdog [ms].
    """

    sequence: int
    values: tuple[float, ...]


DeviceAnswer = Report | Greeting | LimitsAnswer


def encode_command(command: Command) -> bytes:
    """The bytes of a command, delimiter included."""
    return _build_frame(
        command.kind,
        command.sequence,
        _BODIES.get(command.kind, _NONE).pack(*command.values),
    )


def decode_command(frame: bytes) -> Command:
    """A command from the bytes between two delimiters; raises FrameError, also where a
    speed is no number.
    """
    kind, sequence, body = _parse_frame(frame)
    layout = _BODIES.get(kind, _NONE)
    if kind >= FrameKind.ANSWER or len(body) != layout.size:
        raise FrameError(f"command {kind!r} of {len(body)} bytes")
    values = layout.unpack(body)
    if not all(map(math.isfinite, values)):
        raise FrameError("a speed that is no number")
    return Command(kind, sequence, values)


def encode_answer(answer: DeviceAnswer) -> bytes:
    """The bytes of an answer, delimiter included."""
    if isinstance(answer, Greeting):
        body = _GREETING.pack(
            answer.version, answer.joints, answer.watchdog, answer.state
        )
        return _build_frame(FrameKind.GREETING, answer.sequence, body)
    if isinstance(answer, LimitsAnswer):
        return _build_frame(
            FrameKind.LIMITED, answer.sequence, _LIMITS.pack(*answer.values)
        )
    return _build_frame(
        FrameKind.ANSWER,
        answer.sequence,
        _ANSWER.pack(answer.micros, answer.state, *answer.angles),
    )


def decode_answer(frame: bytes) -> DeviceAnswer:
    """An answer from the bytes between two delimiters; raises FrameError, also where an
    angle is no number.
    """
    kind, sequence, body = _parse_frame(frame)
    try:
        if kind is FrameKind.ANSWER:
            micros, state, *angles = _ANSWER.unpack(body)
            if not all(map(math.isfinite, angles)):
                raise FrameError("an encoder reports no number")
            return Report(sequence, micros, DeviceState(state), tuple(angles))
        if kind is FrameKind.GREETING:
            version, joints, watchdog, state = _GREETING.unpack(body)
            return Greeting(sequence, version, joints, watchdog, DeviceState(state))
        if kind is FrameKind.LIMITED:
            return LimitsAnswer(sequence, _LIMITS.unpack(body))
    except (struct.error, ValueError) as error:
        raise FrameError(str(error)) from error
    raise FrameError(f"answer {kind!r}")


def is_newer(sequence: int, last: int) -> bool:
    """Whether a sequence number comes after another, round the end of 16 bits."""
    return 0 < (sequence - last) % 2**16 < 2**15


def _build_frame(kind: FrameKind, sequence: int, body: bytes) -> bytes:
    payload = _HEAD.pack(kind, sequence) + body
    return encode_cobs(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"


def _parse_frame(frame: bytes) -> tuple[FrameKind, int, bytes]:
    whole = decode_cobs(frame)
    if len(whole) < 4 + _HEAD.size or struct.unpack("<I", whole[-4:])[0] != zlib.crc32(
        whole[:-4]
    ):
        raise FrameError("checksum")
    kind, sequence = _HEAD.unpack_from(whole)
    try:
        return FrameKind(kind), sequence, whole[_HEAD.size : -4]
    except ValueError as error:
        raise FrameError(str(error)) from error


def encode_cobs(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker 1999): no zero byte in the
    result.
    """
    blocks = data.split(b"\0")
    result = bytearray()
    for block in blocks:
        while len(block) >= 254:
            result += b"\xff" + block[:254]  # of a full block no zero was taken out
            block = block[254:]  # noqa: PLW2901
        result += bytes([len(block) + 1]) + block
    return bytes(result)


def decode_cobs(data: bytes) -> bytes:
    """The inverse of `cobs`; raises FrameError."""
    result, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            raise FrameError("stuffing")
        result += data[at + 1 : at + code]
        at += code
        # neither a full block nor the last stands before a zero
        if code < 255 and at < len(data):
            result.append(0)
    return bytes(result)


class Deframer:
    """Cuts a stream of bytes into what stands between delimiters. What is too long to
    be a frame is dropped.
    """

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.rest = b""

    def frames(self, data: bytes) -> list[bytes]:
        """The whole frames, empty ones left out, once their delimiter has come."""
        *parts, rest = (self.rest + data).split(b"\0")
        self.rest = rest[: MAX_FRAME_BYTES + 1]  # enough to know that it is too long
        return [part for part in parts if 0 < len(part) <= MAX_FRAME_BYTES]
