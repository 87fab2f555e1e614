"""Runs that are interrupted during a movement."""

import json
import os
import signal
import subprocess
import sys
import time

from conftest import ROOT, share
from rig import events

from stringcast.hardware.serial.rehearsal import LOG_VARIABLE

# a share of the cores, because parallel tests depend on clocks
SHARED = os.environ | {"NUMBA_NUM_THREADS": str(share())}
SMALL = (
    "+experiment=quick",
    "hardware=emulator",
    "mode.stages=[generate,execute,extract]",
    "saved_outputs=[]",
    "camera.fps=25",
)


def interrupt_command(number, record, *arguments):
    """Send a signal to a command once the arm moves; return exit status and output.

    `record` is the file of the emulator, whose arm is still in the end.
    """
    record.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pipeline", *arguments]
    environment = SHARED | {LOG_VARIABLE: str(record)}
    run = subprocess.Popen(
        command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True
    )
    while "moves" not in {
        noted["event"] for noted in (events(record) if record.exists() else [])
    }:
        assert run.poll() is None, run.stderr.read()
        time.sleep(0.02)
    run.send_signal(number)
    words = run.communicate(timeout=20)[1]
    noted = events(record)
    assert {"latched", "stands"} <= {e["event"] for e in noted}, noted
    assert noted[-1]["state"] == "latched"
    assert max(map(abs, noted[-1]["speeds"])) < 0.02
    return run.returncode, words


def test_terminated_run_stops_the_arm_and_can_continue(tmp_path, called):
    record, folder = tmp_path / "record", tmp_path / "a run"
    asked = (*SMALL, f"hydra.run.dir={folder}")
    status, words = interrupt_command(signal.SIGTERM, record, *asked)
    assert status == 143
    assert (
        f"-m pipeline resume '{folder}'"
        in words.partition("Continue after the last step: ")[2]
    )
    assert not (folder / "run.json").exists()
    assert interrupt_command(signal.SIGINT, record, "resume", str(folder))[0] == 130
    continued = called("resume", folder)
    assert continued.returncode == 0, continued.stderr
    assert {step.name for step in (folder / "iterations/01").iterdir()} == {
        "motion",
        "trial",
        "points",
    }
    assert json.loads((folder / "run.json").read_text())["sentence"]
