"""Clear bus watchdogs after a person has checked the arm.

Usage: `python -m stringcast.hardware.dynamixel.clear PORT ID ...`.
"""

from __future__ import annotations

import argparse

from stringcast.hardware.arm.wire import confirm_and_clear
from stringcast.hardware.dynamixel.bus import DynamixelBus, ServoSettings


def main() -> None:
    """Ask a person to check the arm, then clear."""
    parser = argparse.ArgumentParser(
        prog="python -m stringcast.hardware.dynamixel.clear", description=__doc__
    )
    parser.add_argument("port")
    parser.add_argument("id", type=int, nargs="+")
    parser.add_argument("--baud", type=int, default=4_000_000)
    options = parser.parse_args()
    servos = [ServoSettings(number, 0, 1) for number in options.id]
    confirm_and_clear(DynamixelBus(options.port, options.baud, servos, (), 0.1, 1))


if __name__ == "__main__":
    main()
