"""Set up and run, with nothing but Python: `python3 tasks.py run`, `python3 tasks.py test`.

run [OVERRIDES]    the main job: `python -m pipeline OVERRIDES`, by default +experiment=stringB
test [ARGUMENTS]   style, types and tests; arguments go to pytest
test --all         ... with the long ones
bench              how fast strings are simulated, beside MuJoCo and PyElastica; see tests/speed
setup              only make the environment

The environment is `.venv`, made from `requirements.lock` and made again when that changes.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
BENCH_LOCK = ROOT / "tests" / "speed" / "requirements.lock"
PYTHON = ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
SIDE_BY_SIDE = ("--numprocesses=auto", "--dist=loadfile", "--no-loadscope-reorder")
TIMED = "tests/drivers"  # by real clocks: they run alone
CHECKS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
)


def main(arguments: list[str]) -> int:
    """Run one task; its exit status."""
    task, rest = (arguments[0], arguments[1:]) if arguments else ("help", [])
    if task not in TASKS:
        print(__doc__)
        return 0 if task in ("help", "-h", "--help") else 2
    setup()
    return TASKS[task](rest)


def setup() -> None:
    """Make `.venv` hold exactly what the lock says."""
    if sys.version_info < (3, 11):
        sys.exit(
            f"stringcast needs Python 3.11 or newer; this is {sys.version.split()[0]}. Run tasks.py with a newer one."
        )
    if not installed(LOCK):
        print("Setting up .venv (once; a minute or two) ...", flush=True)
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
        install(LOCK)


def mark(lock: Path) -> Path:
    """A file in the environment that names the lock it was made from."""
    return ENVIRONMENT / ("locked" if lock == LOCK else f"locked-{lock.parent.name}")


def digest(lock: Path) -> str:
    """Of a lock and this Python."""
    return hashlib.sha256(lock.read_bytes() + sys.version.encode()).hexdigest()


def installed(lock: Path) -> bool:
    """Whether the environment holds this lock as it is now."""
    return mark(lock).exists() and mark(lock).read_text() == digest(lock)


def install(lock: Path) -> None:
    """Install what a lock says, and note it."""
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes", "-r", lock]
    if subprocess.run(pip, check=False).returncode:
        sys.exit(f"The packages of {lock.name} could not be installed; see above. Is a package registry in reach?")
    mark(lock).write_text(digest(lock))


def call(*command: str) -> int:
    """Run a module of the environment in the project's folder."""
    return subprocess.run([PYTHON, "-m", *command], cwd=ROOT, check=False).returncode


def run(rest: list[str]) -> int:
    """The pipeline."""
    return call("pipeline", *(rest or ["+experiment=stringB"]))


def test(rest: list[str]) -> int:
    """Style, types, tests: all of them, and 0 only if each is clean. Files of tests run side by side, on all cores."""
    results = [call(*check) for check in CHECKS]
    if rest not in ([], ["--all"]):
        return worst(*results, call("pytest", *rest))
    which = ["-m", ""] if rest else []
    results.append(call("pytest", *SIDE_BY_SIDE, f"--ignore={TIMED}", *which))
    return worst(*results, call("pytest", TIMED, *which))


def worst(*codes: int) -> int:
    """0 if every command ended with 0, else 1: what a signal ended has a negative code, and pytest ends with 5 where
    it found no test."""
    return int(any(codes))


def bench(rest: list[str]) -> int:
    """The benchmark, with the packages it compares with."""
    if not installed(BENCH_LOCK):
        install(BENCH_LOCK)
    return call("tests.speed", *rest)


TASKS = {"run": run, "test": test, "bench": bench, "setup": lambda rest: 0}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
