"""Shared parts of the driver tests: emulated devices, a driver and a movement."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, SPEEDS
from stringcast.hardware.arm import Driving, VelocityArm
from stringcast.hardware.arm.limits import Workspace
from stringcast.hardware.serial.wire import SerialWire
from stringcast.stages.model.arm import Arm

ARM = Arm(
    (0.25, 0.2, 0.135),
    (0.0, 0.0),
    (-2.0,) * 3,
    (2.0,) * 3,
    (20.0,) * 3,
    (300.0,) * 3,
    21.8,
    0.005,
)
WORKSPACE = Workspace((-0.6, -0.6), (0.6, 0.6))
# Time budgets and the watchdog (`emulator`) are wide, as test machines are busy.
DRIVING = Driving(
    1.0, 20, 0.1, 0.5, 3.0, approach=2.0, settle=0.0, priority=0, workspace=WORKSPACE
)
WATCHDOG = 0.25  # [s]


def driver(port, arm=ARM, **changed):
    return VelocityArm(
        arm, SerialWire(port, 1_000_000), Driving(**{**vars(DRIVING), **changed})
    )


def movement(duration=0.3):
    t = np.arange(0, duration + 1e-9, 0.005)
    q = np.stack(
        [a * (1 - np.cos(np.pi * t / duration)) / 2 for a in (0.5, -0.4, 0.6)], axis=-1
    )
    w = np.concatenate([np.diff(q, axis=0) / 0.005, np.zeros((1, 3))])
    return pd.DataFrame(
        {"t": t}
        | dict(zip(JOINTS, q.T, strict=True))
        | dict(zip(SPEEDS, w.T, strict=True))
    )


@contextmanager
def emulator(
    log,
    *options,
    command=(sys.executable, "-m", "stringcast.hardware.serial.emulator"),
    watchdog=WATCHDOG,
):
    """Serve an emulated device within the block and yield the name of its port."""
    patience = ["--watchdog", str(round(watchdog * 1e3))] if watchdog else []
    whole = [*command, "--log", str(log), "--until", "60", *patience, *options]
    process = subprocess.Popen(whole, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def events(log):
    """Read the recorded events of the firmware, oldest first."""
    return [
        json.loads(line) for line in log.read_text().splitlines() if line.endswith("}")
    ]


def standstill(log, since, within=5.0):
    """Wait until the arm is at rest.

    Returns seconds of device time since the first event `since`, or None.
    """
    end = time.monotonic() + within
    while time.monotonic() < end:
        noted = events(log)
        first = next((e["t"] for e in noted if e["event"] == since), None)
        motion = [e for e in noted if e["event"] in ("stands", "moves")]
        if (
            first is not None
            and (not motion or motion[-1]["event"] == "stands")
            and noted[-1]["state"] != "moving"
        ):
            time.sleep(0.05)
            if len(events(log)) == len(noted):
                return max(motion[-1]["t"] - first, 0.0) if motion else 0.0
        time.sleep(0.02)
    return None
