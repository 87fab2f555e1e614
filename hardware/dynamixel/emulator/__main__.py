"""`python -m stringcast.hardware.dynamixel.emulator`: serve three servos on a
pseudo-terminal.

Its name is printed first. It ends with whoever started it.
"""

from __future__ import annotations

import json

from stringcast.hardware.dynamixel.emulator.bus import (
    FAULTS,
    EmulatedBus,
    EmulatedServo,
)
from stringcast.hardware.dynamixel.registers import TORQUE_ENABLE
from stringcast.hardware.emulated.terminal import command_parser, serve

UNPLUGGED_S = 1.0  # [s] for which unplugged servos go on


def main() -> None:
    """Serve until --until seconds are over."""
    options = command_parser(
        "python -m stringcast.hardware.dynamixel.emulator", __doc__, FAULTS
    ).parse_args()
    with options.log.open("w", buffering=1) as log:
        servos = {number: EmulatedServo() for number in (1, 2, 3)}
        bus = EmulatedBus(
            dict(options.fault),
            lambda event, bus: log.write(log_line(event, bus)),
            servos,
        )
        serve(bus, options.until, UNPLUGGED_S)


def log_line(event: str, bus: EmulatedBus) -> str:
    """An event with what the servos are about, as JSON: time [s], angles [rad], torque."""
    servos = bus.servos.values()
    row = {
        "event": event,
        "t": bus.clock,
        "state": event,
        "angles": [s.joint.angle for s in servos],
    }
    return json.dumps(row | {"torque": [s.get(TORQUE_ENABLE) for s in servos]}) + "\n"


if __name__ == "__main__":
    main()
