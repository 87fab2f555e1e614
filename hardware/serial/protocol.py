"""Frames on the wire: COBS, CRC-32, sequence numbers. Specification in README.md beside this file."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

PING, VELOCITY, STOP, ACKNOWLEDGED = 0x01, 0x02, 0x03, 0x81
JOINTS = 3
_HEAD = struct.Struct("<BH")
_SPEEDS = struct.Struct(f"<{JOINTS}f")
_ANSWER = struct.Struct(f"<IB{JOINTS}f")


class FrameError(Exception):
    """Bytes that are no whole frame of ours."""


@dataclass(frozen=True)
class Command:
    """Host to device. speeds: [rad/s], only with VELOCITY."""

    kind: int
    sequence: int
    speeds: tuple[float, ...] = ()


@dataclass(frozen=True)
class Answer:
    """Device to host. clock: device time [s], wraps at 2^32 microseconds. stopped: by watchdog or STOP.
    angles: measured [rad]."""

    sequence: int
    clock: float
    stopped: bool
    angles: tuple[float, ...]


def encode_command(command: Command) -> bytes:
    """The bytes of a command, delimiter included."""
    body = _SPEEDS.pack(*command.speeds) if command.kind == VELOCITY else b""
    return _framed(_HEAD.pack(command.kind, command.sequence) + body)


def decode_command(frame: bytes) -> Command:
    """A command from the bytes between two delimiters; raises FrameError."""
    payload = _unframed(frame)
    kind, sequence = _HEAD.unpack_from(payload)
    expected = _HEAD.size + (_SPEEDS.size if kind == VELOCITY else 0)
    if kind not in (PING, VELOCITY, STOP) or len(payload) != expected:
        raise FrameError(f"command {kind:#x} of {len(payload)} bytes")
    return Command(kind, sequence, _SPEEDS.unpack_from(payload, _HEAD.size) if kind == VELOCITY else ())


def encode_answer(answer: Answer) -> bytes:
    """The bytes of an answer, delimiter included."""
    micros = round(answer.clock * 1e6) % 2**32
    body = _ANSWER.pack(micros, answer.stopped, *answer.angles)
    return _framed(_HEAD.pack(ACKNOWLEDGED, answer.sequence) + body)


def decode_answer(frame: bytes) -> Answer:
    """An answer from the bytes between two delimiters; raises FrameError."""
    payload = _unframed(frame)
    if len(payload) != _HEAD.size + _ANSWER.size or payload[0] != ACKNOWLEDGED:
        raise FrameError(f"answer of {len(payload)} bytes")
    micros, stopped, *angles = _ANSWER.unpack_from(payload, _HEAD.size)
    return Answer(_HEAD.unpack_from(payload)[1], micros * 1e-6, bool(stopped), tuple(angles))


def _framed(payload: bytes) -> bytes:
    return cobs(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"


def _unframed(frame: bytes) -> bytes:
    whole = uncobs(frame)
    if len(whole) < 4 + _HEAD.size or struct.unpack("<I", whole[-4:])[0] != zlib.crc32(whole[:-4]):
        raise FrameError("checksum")
    return whole[:-4]


def cobs(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker 1999): no zero byte in the result."""
    blocks = data.split(b"\0")
    result = bytearray()
    for block in blocks:
        while len(block) >= 254:
            result += b"\xff" + block[:254]
            block = block[254:]  # noqa: PLW2901
        result += bytes([len(block) + 1]) + block
    return bytes(result)


def uncobs(data: bytes) -> bytes:
    """The inverse of `cobs`; raises FrameError."""
    result, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            raise FrameError("stuffing")
        result += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            result.append(0)
    return bytes(result)
