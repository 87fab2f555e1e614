"""`python -m stringcast.hardware.dynamixel.clear PORT ID ...`: undo bus watchdogs, after a person has looked."""

from __future__ import annotations

import argparse
import sys

from stringcast.hardware.dynamixel.bus import DynamixelBus, Servo
from stringcast.stages.execute.interfaces import HardwareError


def main() -> None:
    """Ask, then clear."""
    parser = argparse.ArgumentParser(prog="python -m stringcast.hardware.dynamixel.clear", description=__doc__)
    parser.add_argument("port")
    parser.add_argument("id", type=int, nargs="+")
    parser.add_argument("--baud", type=int, default=4_000_000)
    options = parser.parse_args()
    if input("Is the arm safe to move, and nobody within its reach? Type yes: ").strip() != "yes":
        sys.exit("It stays latched.")
    bus = DynamixelBus(options.port, options.baud, [Servo(i, 0, 1) for i in options.id], (), 0.1, 1)
    try:
        bus.clear()
    except HardwareError as error:
        sys.exit(f"Error: {error}")
    finally:
        bus.close()
    print("Cleared.")


if __name__ == "__main__":
    main()
