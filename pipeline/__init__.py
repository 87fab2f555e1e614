"""The shell: configuration, folders, seeds, progress, resuming. The only place that
knows Hydra.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

# `python -m pipeline` in a clone, which is `python -m stringcast` of that clone
if __name__ == "pipeline":
    found = find_spec("stringcast")
    there = Path(found.origin).resolve().parents[2] if found and found.origin else None
    if there != Path(__file__).resolve().parents[1]:
        wrong = f"its stringcast is that of {there}" if there else "it lacks stringcast"
        python, scripts = ("py", "Scripts") if os.name == "nt" else ("python3", "bin")
        remedy = f"Run {python} tasks.py setup here, then {Path('.venv', scripts, 'python')} -m pipeline"
        sys.exit(f"Error: {sys.executable}: {wrong}. {remedy}.")
