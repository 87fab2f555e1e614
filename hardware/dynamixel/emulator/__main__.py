"""Serve three emulated servos on a pseudo-terminal, and print its name.

Usage: `python -m stringcast.hardware.dynamixel.emulator`. It ends with its parent
process.
"""

from __future__ import annotations

from stringcast.hardware.dynamixel.emulator.bus import (
    FAULTS,
    EmulatedBus,
    EmulatedServo,
)
from stringcast.hardware.emulated.terminal import command_parser, serve

UNPLUGGED_S = 1.0  # [s] that unplugged servos run on


def main() -> None:
    """Serve the bus for --until seconds."""
    options = command_parser(
        "python -m stringcast.hardware.dynamixel.emulator", __doc__, FAULTS
    ).parse_args()
    with options.log.open("w", buffering=1) as log:
        servos = {number: EmulatedServo() for number in (1, 2, 3)}
        bus = EmulatedBus(dict(options.fault), log, servos)
        serve(bus, options.until, UNPLUGGED_S)


if __name__ == "__main__":
    main()
