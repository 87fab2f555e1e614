"""Clear the emergency stop after a person has checked the arm.

Usage: `python -m stringcast.hardware.serial.clear PORT`.
"""

from __future__ import annotations

import argparse

from stringcast.hardware.arm.wire import confirm_and_clear
from stringcast.hardware.serial.wire import SerialWire


def main() -> None:
    """Ask a person to check the arm, then clear."""
    parser = argparse.ArgumentParser(
        prog="python -m stringcast.hardware.serial.clear", description=__doc__
    )
    parser.add_argument("port")
    parser.add_argument("--baud", type=int, default=1_000_000)
    options = parser.parse_args()
    confirm_and_clear(SerialWire(options.port, options.baud))


if __name__ == "__main__":
    main()
