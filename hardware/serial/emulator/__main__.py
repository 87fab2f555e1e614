"""`python -m stringcast.hardware.serial.emulator`: serve a device on a pseudo-terminal, whose name is printed first.

It ends with whoever started it.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path

from stringcast.hardware.emulated.terminal import serve
from stringcast.hardware.serial.emulator.device import KINDS, Device
from stringcast.hardware.serial.firmware import Firmware

AFTER = 0.5  # [s] for which an unplugged device goes on


def main() -> None:
    """Serve until --until seconds are over; an unplugged device goes on alone until its arm stands."""
    options = parsed()
    with options.log.open("w", buffering=1) as log:
        device = Device(Firmware(options.watchdog), dict(options.fault), noter(log.write), options.since)
        serve(device, options.until, AFTER)


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m stringcast.hardware.serial.emulator", description=__doc__)
    parser.add_argument("--log", type=Path, default=Path(os.devnull), help="events, a line of JSON each")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        type=fault,
        metavar="KIND:N",
        help=f"at the N-th velocity command: {', '.join(KINDS)}",
    )
    parser.add_argument("--watchdog", type=int, default=25, help="[ms]")
    parser.add_argument("--since", type=int, default=0, help="the device's clock at the start [us]")
    parser.add_argument("--until", type=float, default=600.0, help="[s] after which it ends")
    return parser.parse_args()


def fault(text: str) -> tuple[int, str]:
    """Number and kind, from KIND:N."""
    kind, _, number = text.partition(":")
    if kind not in KINDS:
        raise argparse.ArgumentTypeError(f"there is no fault '{kind}'; known are {', '.join(KINDS)}")
    return int(number), kind


def noter(write: Callable[[str], object]) -> Callable[[str, Device], None]:
    """Write an event with what the device is about: time [s], angles [rad], speeds [rad/s]."""

    def note(event: str, device: Device) -> None:
        joints = device.joints.joints
        row = {"event": event, "t": device.clock, "state": device.firmware.state.name.lower()}
        row |= {"angles": [j.angle for j in joints], "speeds": [j.speed for j in joints]}
        write(json.dumps(row) + "\n")

    return note


if __name__ == "__main__":
    main()
