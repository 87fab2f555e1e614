"""Frames of the serial link: COBS, CRC-32, sequence numbers.

The specification is README.md in this folder.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

PROTOCOL_VERSION = 3  # must be equal in device and driver
JOINT_COUNT = 3  # joints of a velocity command
MAX_FRAME_BYTES = 64  # bytes between delimiters


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
    CLAMPED = 5  # as MOVING, after a velocity was clamped to the limits


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
    """Bytes that are not a valid frame."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the host.

    values: VELOCITY: speeds [rad/s]; HELLO: the host's version; LIMITS: as in
    `LimitsAnswer`; otherwise empty.
    """

    kind: FrameKind
    sequence: int
    values: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """The device's answer to most commands.

    micros: device clock [us], wraps at 2^32. angles: measured [rad].
    """

    sequence: int
    micros: int
    state: DeviceState
    angles: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Greeting:
    """The device's answer to HELLO; the watchdog is in [ms]."""

    sequence: int
    version: int
    joints: int
    watchdog: int
    state: DeviceState


@dataclass(frozen=True, slots=True)
class LimitsAnswer:
    """The device's answer to LIMITS: the limits in force.

    values: largest speed [rad/s] and acceleration [rad/s^2] of each joint, the host's
    tick [us], the watchdog [ms].
    """

    sequence: int
    values: tuple[float, ...]


DeviceAnswer = Report | Greeting | LimitsAnswer


def encode_command(command: Command) -> bytes:
    """Encode a command, with its delimiter."""
    body = _BODIES.get(command.kind, _NONE).pack(*command.values)
    return _build_frame(command.kind, command.sequence, body)


def decode_command(frame: bytes) -> Command:
    """Decode a command from the bytes between two delimiters.

    Raises FrameError for an invalid command or a speed that is not finite.
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
    """Encode an answer, with its delimiter."""
    if isinstance(answer, Greeting):
        kind = FrameKind.GREETING
        body = _GREETING.pack(
            answer.version, answer.joints, answer.watchdog, answer.state
        )
    elif isinstance(answer, LimitsAnswer):
        kind = FrameKind.LIMITED
        body = _LIMITS.pack(*answer.values)
    else:
        kind = FrameKind.ANSWER
        body = _ANSWER.pack(answer.micros, answer.state, *answer.angles)
    return _build_frame(kind, answer.sequence, body)


def decode_answer(frame: bytes) -> DeviceAnswer:
    """Decode an answer from the bytes between two delimiters.

    Raises FrameError for an invalid answer or an angle that is not finite.
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
    """Return whether a sequence number comes after another, with a wrap at 16 bits."""
    return 0 < (sequence - last) % 2**16 < 2**15


def _build_frame(kind: FrameKind, sequence: int, body: bytes) -> bytes:
    payload = _HEAD.pack(kind, sequence) + body
    return encode_cobs(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"


def _parse_frame(frame: bytes) -> tuple[FrameKind, int, bytes]:
    content = decode_cobs(frame)
    payload, checksum = content[:-4], content[-4:]
    if len(payload) < _HEAD.size or checksum != struct.pack("<I", zlib.crc32(payload)):
        raise FrameError("checksum")
    kind, sequence = _HEAD.unpack_from(payload)
    try:
        return FrameKind(kind), sequence, payload[_HEAD.size :]
    except ValueError as error:
        raise FrameError(str(error)) from error


def encode_cobs(data: bytes) -> bytes:
    """Encode bytes without zeros (consistent overhead byte stuffing).

    References
    ----------
    Cheshire, S., Baker, M. (1999). Consistent overhead byte stuffing. IEEE/ACM Trans.
    Netw. 7, 159-172.
    """
    blocks = data.split(b"\0")
    result = bytearray()
    for block in blocks:
        while len(block) >= 254:
            result += b"\xff" + block[:254]  # a full block has no zero removed
            block = block[254:]  # noqa: PLW2901
        result += bytes([len(block) + 1]) + block
    return bytes(result)


def decode_cobs(data: bytes) -> bytes:
    """Decode what `encode_cobs` encoded; raise FrameError for other bytes."""
    result, position = bytearray(), 0
    while position < len(data):
        code = data[position]
        if code == 0 or position + code > len(data):
            raise FrameError("stuffing")
        result += data[position + 1 : position + code]
        position += code
        # no zero follows a full block or the last block
        if code < 255 and position < len(data):
            result.append(0)
    return bytes(result)


@dataclass
class Deframer:
    """A splitter of a byte stream at delimiters; drops frames that are too long."""

    rest: bytes = b""

    def frames(self, data: bytes) -> list[bytes]:
        """Add data; return completed frames without empty ones."""
        *parts, rest = (self.rest + data).split(b"\0")
        self.rest = rest[: MAX_FRAME_BYTES + 1]  # longer frames are dropped anyway
        return [part for part in parts if 0 < len(part) <= MAX_FRAME_BYTES]
