"""Serve an emulated device on a pseudo-terminal, and print its name.

Usage: `python -m stringcast.hardware.serial.emulator`. It ends with its parent process.
"""

from __future__ import annotations

from stringcast.hardware.emulated.terminal import command_parser, serve
from stringcast.hardware.serial.emulator.device import FAULT_KINDS, EmulatedArm
from stringcast.hardware.serial.firmware import Firmware

UNPLUGGED_S = 0.5  # [s] that an unplugged device runs on


def main() -> None:
    """Serve the device for --until seconds.

    An unplugged device runs on until its arm is at rest.
    """
    parser = command_parser(
        "python -m stringcast.hardware.serial.emulator", __doc__, FAULT_KINDS
    )
    parser.add_argument("--watchdog", type=int, default=25, help="[ms]")
    parser.add_argument(
        "--since", type=int, default=0, help="the device's clock at the start [us]"
    )
    options = parser.parse_args()
    with options.log.open("w", buffering=1) as log:
        firmware, faults = Firmware(options.watchdog), dict(options.fault)
        device = EmulatedArm(faults, log, firmware, options.since)
        serve(device, options.until, UNPLUGGED_S)


if __name__ == "__main__":
    main()
