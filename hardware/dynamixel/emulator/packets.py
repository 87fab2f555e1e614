"""Packets of protocol 2.0: header FF FF FD 00, byte stuffing, CRC-16.

References
----------
ROBOTIS e-manual, protocol 2.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x55, 0x82, 0x83


class Packet(NamedTuple):
    """An instruction to one servo or to all."""

    id: int
    instruction: int
    parameters: bytes


def crc16(data: bytes) -> int:
    """Compute the CRC-16 with polynomial 0x8005, from zero, not reflected."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def status_packet(identity: int, error: int, parameters: bytes = b"") -> bytes:
    """Encode the status packet of a servo."""
    content = bytes([STATUS, error]) + parameters
    content = content.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    length = (len(content) + 2).to_bytes(2, "little")
    body = HEADER + bytes([identity]) + length + content
    return body + crc16(body).to_bytes(2, "little")


@dataclass
class PacketSplitter:
    """A splitter of a byte stream into packets; drops damaged ones."""

    rest: bytes = b""

    def packets(self, data: bytes) -> list[Packet]:
        """Add data and return the completed packets."""
        self.rest += data
        packets = []
        while (start := self.rest.find(HEADER)) >= 0:
            self.rest = self.rest[start:]
            # header, identity and length of the rest
            end = 7 + int.from_bytes(self.rest[5:7], "little")
            if len(self.rest) < 7 or len(self.rest) < end:
                break
            packet, self.rest = self.rest[:end], self.rest[end:]
            checksum = int.from_bytes(packet[-2:], "little")
            if len(packet) >= 10 and crc16(packet[:-2]) == checksum:
                content = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                packets.append(Packet(packet[4], content[0], content[1:]))
        return packets
