"""Serve three emulated servos on a pseudo-terminal, whose name is printed first.

It is called as `python -m stringcast.hardware.dynamixel.emulator` and ends with the
process that started it.
"""

from __future__ import annotations

from stringcast.hardware.dynamixel.emulator.bus import (
    FAULTS,
    EmulatedBus,
    EmulatedServo,
)
from stringcast.hardware.emulated.terminal import command_parser, serve

UNPLUGGED_S = 1.0  # [s] for which unplugged servos go on


def main() -> None:
    """Serve the bus until --until seconds are over."""
    options = command_parser(
        "python -m stringcast.hardware.dynamixel.emulator", __doc__, FAULTS
    ).parse_args()
    with options.log.open("w", buffering=1) as log:
        servos = {number: EmulatedServo() for number in (1, 2, 3)}
        bus = EmulatedBus(dict(options.fault), log, servos)
        serve(bus, options.until, UNPLUGGED_S)


if __name__ == "__main__":
    main()
