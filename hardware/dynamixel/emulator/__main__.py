"""`python -m stringcast.hardware.dynamixel.emulator`: serve three servos on a pseudo-terminal.

Its name is printed first. It ends with whoever started it.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path

from stringcast.hardware.dynamixel.emulator.bus import STRIKES, Bus, Servo
from stringcast.hardware.dynamixel.registers import TORQUE_ENABLE
from stringcast.hardware.emulated.terminal import serve

AFTER = 1.0  # [s] for which unplugged servos go on


def main() -> None:
    """Serve until --until seconds are over."""
    parser = argparse.ArgumentParser(prog="python -m stringcast.hardware.dynamixel.emulator", description=__doc__)
    parser.add_argument("--log", type=Path, default=Path(os.devnull), help="events, a line of JSON each")
    help_ = f"at the N-th velocity: {', '.join(STRIKES)}"
    parser.add_argument("--fault", action="append", default=[], type=fault, metavar="KIND:N", help=help_)
    parser.add_argument("--until", type=float, default=600.0, help="[s] after which it ends")
    options = parser.parse_args()
    with options.log.open("w", buffering=1) as log:
        bus = Bus({i: Servo() for i in (1, 2, 3)}, dict(options.fault), noter(log.write))
        serve(bus, options.until, AFTER)


def fault(text: str) -> tuple[int, str]:
    """Number and kind, from KIND:N."""
    kind, _, number = text.partition(":")
    if kind not in STRIKES:
        raise argparse.ArgumentTypeError(f"there is no fault '{kind}'; known are {', '.join(STRIKES)}")
    return int(number), kind


def noter(write: Callable[[str], object]) -> Callable[[str, Bus], None]:
    """Write an event with what the servos are about: time [s], angles [rad], torque."""

    def note(event: str, bus: Bus) -> None:
        servos = bus.servos.values()
        row = {"event": event, "t": bus.clock, "state": event, "angles": [s.joint.angle for s in servos]}
        write(json.dumps(row | {"torque": [s.get(TORQUE_ENABLE) for s in servos]}) + "\n")

    return note


if __name__ == "__main__":
    main()
