"""Who asks does not wait for what only a run needs: by the names of modules, for times differ from machine to machine."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"cv2", "jinja2", "matplotlib", "numba", "scipy"}  # 0.1 to 0.5 s each
SHOWN = """
import runpy, sys
sys.argv = ["pipeline", *sys.argv[1:]]
try:
    runpy.run_module("pipeline", run_name="__main__", alter_sys=True)
except SystemExit as ended:
    assert not ended.code, ended
print("loaded:", *sorted({name.partition(".")[0] for name in sys.modules}))
"""


@pytest.mark.parametrize(
    ("words", "light"),
    [(["--help"], {"pandas", "pyarrow", "PIL"}), (["check", "data/sample"], set())],
)
def test_a_question_loads_little(words, light):
    asked = subprocess.run([sys.executable, "-c", SHOWN, *words], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = asked.stdout.splitlines()[-1].split()[1:]
    assert "hydra" in loaded
    assert not (HEAVY | light) & {*loaded}
