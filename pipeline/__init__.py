"""Runs: configuration, folders, seeds, progress and resuming.

Only this package uses Hydra.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

# `python -m pipeline` in a clone is `python -m stringcast` of that clone.
if __name__ == "pipeline":
    package = find_spec("stringcast")
    clone = None
    if package and package.origin:
        clone = Path(package.origin).resolve().parents[2]
    if clone != Path(__file__).resolve().parents[1]:
        fault = (
            f"its stringcast is that of {clone}" if clone else "it has no stringcast"
        )
        python, scripts = ("py", "Scripts") if os.name == "nt" else ("python3", "bin")
        command = f"{Path('.venv', scripts, 'python')} -m pipeline"
        remedy = f"Run {python} tasks.py setup here, then {command}"
        sys.exit(f"Error: {sys.executable}: {fault}. {remedy}.")
