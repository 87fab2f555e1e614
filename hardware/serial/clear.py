"""`python -m stringcast.hardware.serial.clear PORT`: undo the emergency stop, after a person has looked at the arm."""

from __future__ import annotations

import argparse
import sys

from stringcast.hardware.serial.wire import SerialWire
from stringcast.stages.execute.interfaces import HardwareError


def main() -> None:
    """Ask, then clear."""
    parser = argparse.ArgumentParser(prog="python -m stringcast.hardware.serial.clear", description=__doc__)
    parser.add_argument("port")
    parser.add_argument("--baud", type=int, default=1_000_000)
    options = parser.parse_args()
    if input("Is the arm safe to move, and nobody within its reach? Type yes: ").strip() != "yes":
        sys.exit("It stays latched.")
    wire = SerialWire(options.port, options.baud)
    try:
        wire.clear()
    except HardwareError as error:
        sys.exit(f"Error: {error}")
    finally:
        wire.close()
    print("Cleared.")


if __name__ == "__main__":
    main()
