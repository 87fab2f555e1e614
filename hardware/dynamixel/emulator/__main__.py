"""`python -m stringcast.hardware.dynamixel.emulator`: serve three servos on a pseudo-terminal.

Its name is printed first. It ends with whoever started it.
"""

from __future__ import annotations

import json

from stringcast.hardware.dynamixel.emulator.bus import STRIKES, Bus, Servo
from stringcast.hardware.dynamixel.registers import TORQUE_ENABLE
from stringcast.hardware.emulated.terminal import parser, serve

AFTER = 1.0  # [s] for which unplugged servos go on


def main() -> None:
    """Serve until --until seconds are over."""
    options = parser("python -m stringcast.hardware.dynamixel.emulator", __doc__, STRIKES).parse_args()
    with options.log.open("w", buffering=1) as log:
        servos = {number: Servo() for number in (1, 2, 3)}
        bus = Bus(dict(options.fault), lambda event, bus: log.write(line(event, bus)), servos)
        serve(bus, options.until, AFTER)


def line(event: str, bus: Bus) -> str:
    """An event with what the servos are about, as JSON: time [s], angles [rad], torque."""
    servos = bus.servos.values()
    row = {"event": event, "t": bus.clock, "state": event, "angles": [s.joint.angle for s in servos]}
    return json.dumps(row | {"torque": [s.get(TORQUE_ENABLE) for s in servos]}) + "\n"


if __name__ == "__main__":
    main()
