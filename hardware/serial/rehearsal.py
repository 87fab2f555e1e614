"""Rehearsal: the real driver moves an emulated arm and the virtual string."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Annotated, Self

import pandas as pd
from pydantic import Field, PositiveInt

from stringcast.data.artifacts import JOINTS
from stringcast.hardware.arm import Driving, VelocityArm
from stringcast.hardware.camera import FilmingCamera, Source
from stringcast.hardware.serial.wire import SerialWire
from stringcast.hardware.virtual import (
    Look,
    Obstacles,
    Specimen,
    VirtualBench,
    VirtualCamera,
    VirtualServo,
)
from stringcast.stages.execute.interfaces import HardwareError, Lab, Performance
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

BAUD = 1_000_000  # a pseudo-terminal takes any
# Environment variable with the log file of the device. It is not a setting, as settings
# of foreign runs must not name a file to write.
LOG_VARIABLE = "STRINGCAST_EMULATOR_LOG"


@contextmanager
def emulated_device(options: Sequence[str]) -> Iterator[str]:
    """Run an emulated device in its own process and yield its port."""
    command = ["-m", "stringcast.hardware.serial.emulator", *options]
    with subprocess.Popen(
        [sys.executable, *command],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        try:
            port = process.stdout.readline().strip()
            if not port:
                raise HardwareError(
                    "emulator",
                    "it did not start",
                    f"Try it alone: {' '.join(command)}",
                )
            yield port
        finally:
            process.terminate()


@dataclass(kw_only=True)
class RehearsalArm(VelocityArm):
    """The real driver with an emulated device.

    The virtual string follows the angles measured by the device.
    """

    options: Sequence[str]
    bench: VirtualBench
    emulator: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> Self:
        """Start the device and open the link to it."""
        port = self.emulator.enter_context(emulated_device(self.options))
        self.wire = SerialWire(port, BAUD)
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        """Stop, then end the device."""
        with self.emulator:
            super().__exit__(*error)

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Play the commands, and let the bench's string follow the measured angles."""
        performance = super().perform(commands)
        measured = performance.arm
        self.bench.performed_motion = (
            measured["t"].to_numpy(),
            measured[list(JOINTS)].to_numpy(),
        )
        return performance


def open_lab(
    arm: Arm,
    camera: Camera,
    *,
    seed: int,
    trial: int,
    specimen: Specimen,
    servo: VirtualServo,
    look: Look,
    obstacles: Obstacles,
    driving: Driving,
    watchdog: PositiveInt,
    faults: list[str],
    source: Source | None,
    most_lost: Annotated[float, Field(ge=0, le=1)],
) -> Lab:
    """Open the emulated arm and the camera of one trial.

    Parameters
    ----------
    arm, camera, seed, trial, specimen, servo, look, obstacles
        As for the virtual lab; only the servo's time step is used.
    driving
        Settings of the driver; see `Driving`.
    watchdog
        Watchdog time of the device [ms].
    faults
        KIND:N, as in the emulator's options.
    source, most_lost
        A real camera; see `FilmingCamera`. None for the virtual one.

    Returns
    -------
    Lab
        Arm and camera, not yet started.
    """
    bench = VirtualBench(arm, camera, specimen, seed, servo, look, obstacles, trial)
    log_file = os.environ.get(LOG_VARIABLE, os.devnull)
    options = ["--watchdog", str(watchdog), "--log", log_file]
    options += [f"--fault={fault}" for fault in faults]
    wire = SerialWire("", BAUD)  # the port is set when the emulator runs
    rehearsal = RehearsalArm(arm, wire, driving, options=options, bench=bench)
    if source is not None:
        return Lab(rehearsal, FilmingCamera(camera, source, most_lost))
    return Lab(rehearsal, VirtualCamera(bench))
