"""A command does not load packages that only a run needs.

Names of modules are tested, because times differ from machine to machine.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.toy import toy_experiment, toy_run

ROOT = Path(__file__).resolve().parents[2]
# loading takes 0.1 to 0.5 s each
HEAVY = {"cv2", "jinja2", "matplotlib", "numba", "scipy"}
SHOWN = """
import runpy, sys
sys.argv = ["pipeline", *sys.argv[1:]]
try:
    runpy.run_module("pipeline", run_name="__main__", alter_sys=True)
except SystemExit as ended:
    assert not ended.code, ended
print("loaded:", *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def loaded(*words):
    """Return the packages that a command has loaded when it ends."""
    command = [sys.executable, "-c", SHOWN, *map(str, words)]
    asked = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {*asked.stdout.splitlines()[-1].split()[1:]}


def test_help_loads_little():
    assert not (HEAVY | {"pandas", "pyarrow"}) & loaded("--help")


@pytest.mark.long
def test_points_are_checked_without_opencv_and_serial():
    assert not {"cv2", "serial"} & loaded("check", "data/sample")


def test_what_a_run_was_made_of_is_found_without_loading_it(tmp_path):
    toy_run(tmp_path / "run", toy_experiment(1))
    assert not HEAVY & loaded("index", tmp_path)
