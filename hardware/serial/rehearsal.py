"""A rehearsal: the real driver on an emulated arm, which swings the virtual string."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Annotated, Self

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS
from stringcast.hardware.arm import Driving, VelocityArm
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
# Environment variable with the file in which the device records motion and rest. It is
# no setting: settings come from other people's runs too, and must not name a file to
# write.
LOG_VARIABLE = "STRINGCAST_EMULATOR_LOG"


@dataclass
class EmulatorProcess:
    """An emulated device in its own process; entering returns its port."""

    options: Sequence[str]
    process: subprocess.Popen[str] | None = None

    def __enter__(self) -> str:
        """Start the process and return the device's port."""
        command = ["-m", "stringcast.hardware.serial.emulator", *self.options]
        self.process = subprocess.Popen(
            [sys.executable, *command],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self.process.stdout is not None
        port = self.process.stdout.readline().strip()
        if not port:
            self.__exit__(None, None, None)
            raise HardwareError(
                f"emulator: it did not start. Try it alone: {' '.join(command)}"
            )
        return port

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the process."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait()
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.process = None


@dataclass
class RehearsalArm:
    """The real driver on an emulated device, which fills the role `ArmDevice`.

    The string of the virtual bench follows what the device measured.
    """

    device: VelocityArm
    emulator: EmulatorProcess
    bench: VirtualBench

    def __enter__(self) -> Self:
        """Start the device and open the link to it."""
        self.device.wire = SerialWire(self.emulator.__enter__(), BAUD)
        try:
            self.device.__enter__()
        except BaseException:
            self.emulator.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop, then end the device."""
        try:
            self.device.__exit__(kind, error, trace)
        finally:
            self.emulator.__exit__(kind, error, trace)

    def angles(self) -> np.ndarray:
        """Return the joint angles that the device reports, (J,) [rad]."""
        return self.device.angles()

    def check(self, commands: pd.DataFrame) -> None:
        """Refuse what a real arm would refuse."""
        self.device.check(commands)

    def move_to(self, angles: Sequence[float]) -> None:
        """Move the device to angles (J,) [rad], where the virtual string has settled."""
        self.device.move_to(angles)

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Play the commands, and let the bench's string follow the measured angles."""
        performance = self.device.perform(commands)
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
    watchdog: Annotated[int, Field(gt=0)],
    faults: list[str],
) -> Lab:
    """Open the emulated arm and the virtual camera of one trial.

    Parameters
    ----------
    arm, camera, seed, trial, specimen, servo, look, obstacles
        As for the virtual lab; only the servo's time step is used.
    driving
        Settings of the driver; see `Driving`.
    watchdog
        Watchdog time of the device [ms].
    faults
        KIND:N, as the emulator takes them.

    Returns
    -------
    Lab
        Arm and camera, not yet started.
    """
    bench = VirtualBench(arm, camera, specimen, seed, servo, look, obstacles, trial)
    log_file = os.environ.get(LOG_VARIABLE, os.devnull)
    options = ["--watchdog", str(watchdog), "--log", log_file]
    options += [f"--fault={fault}" for fault in faults]
    device = VelocityArm(arm, SerialWire("", BAUD), driving)
    rehearsal = RehearsalArm(device, EmulatorProcess(options), bench)
    return Lab(rehearsal, VirtualCamera(bench))
