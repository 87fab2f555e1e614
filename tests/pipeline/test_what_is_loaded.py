"""Commands do not load packages that only a run needs.

Module names are tested, as times differ between machines.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.toy import toy_experiment, toy_run

ROOT = Path(__file__).resolve().parents[2]
# each takes 0.1 to 0.5 s to load
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


def loaded_packages(*words):
    """Return the packages loaded by a command."""
    command = [sys.executable, "-c", SHOWN, *map(str, words)]
    result = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {*result.stdout.splitlines()[-1].split()[1:]}


def test_help_loads_no_heavy_packages():
    assert not (HEAVY | {"pandas", "pyarrow"}) & loaded_packages("--help")


@pytest.mark.long
def test_check_of_points_loads_neither_opencv_nor_pyserial():
    assert not {"cv2", "serial"} & loaded_packages("check", "data/sample")


def test_index_loads_no_heavy_packages(tmp_path):
    toy_run(tmp_path / "run", toy_experiment(1))
    assert not HEAVY & loaded_packages("index", tmp_path)
