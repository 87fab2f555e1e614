"""Packets of protocol 2.0 (e-manual, ROBOTIS): header FF FF FD 00, byte stuffing,
CRC-16.
"""

from __future__ import annotations

from typing import NamedTuple

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x55, 0x82, 0x83


class Packet(NamedTuple):
    """An instruction to the servo `id`, or to all."""

    id: int
    instruction: int
    parameters: bytes


def crc16(data: bytes) -> int:
    """Polynomial 0x8005, from zero, not reflected."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def status_packet(identity: int, error: int, parameters: bytes = b"") -> bytes:
    """The bytes of a status packet, Protocol 2.0: of a servo, with its error and what
    was asked for.
    """
    content = (bytes([STATUS, error]) + parameters).replace(
        b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
    )
    body = (
        HEADER + bytes([identity]) + (len(content) + 2).to_bytes(2, "little") + content
    )
    return body + crc16(body).to_bytes(2, "little")


class PacketSplitter:
    """Cuts a stream of bytes into packets; damaged ones are left out."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.rest = b""

    def packets(self, data: bytes) -> list[Packet]:
        """The whole packets once their last byte has come."""
        self.rest += data
        found = []
        while (begin := self.rest.find(HEADER)) >= 0:
            self.rest = self.rest[begin:]
            # header, identity and length; the length counts all behind it
            end = 7 + int.from_bytes(self.rest[5:7], "little")
            if len(self.rest) < 7 or len(self.rest) < end:
                break
            packet, self.rest = self.rest[:end], self.rest[end:]
            if len(packet) >= 10 and crc16(packet[:-2]) == int.from_bytes(
                packet[-2:], "little"
            ):
                content = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                found.append(Packet(packet[4], content[0], content[1:]))
        return found
