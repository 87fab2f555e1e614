"""Serve an emulated device on a pseudo-terminal, whose name is printed first.

It is called as `python -m stringcast.hardware.serial.emulator` and ends with the process
that started it.
"""

from __future__ import annotations

import json

from stringcast.hardware.emulated.terminal import command_parser, serve
from stringcast.hardware.serial.emulator.device import FAULT_KINDS, EmulatedArm
from stringcast.hardware.serial.firmware import Firmware

UNPLUGGED_S = 0.5  # [s] for which an unplugged device goes on


def main() -> None:
    """Serve the device until --until seconds are over.

    An unplugged device goes on alone until its arm stands.
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
        device = EmulatedArm(
            faults,
            lambda event, device: log.write(log_line(event, device)),
            firmware,
            options.since,
        )
        serve(device, options.until, UNPLUGGED_S)


def log_line(event: str, device: EmulatedArm) -> str:
    """Write an event with time [s], angles [rad] and speeds [rad/s] as JSON."""
    row = {
        "event": event,
        "t": device.clock,
        "state": device.firmware.state.name.lower(),
        "angles": [joint.angle for joint in device.joints],
        "speeds": [joint.speed for joint in device.joints],
    }
    return json.dumps(row) + "\n"


if __name__ == "__main__":
    main()
