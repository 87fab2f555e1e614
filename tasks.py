"""Set up and run, with nothing but Python: `python3 tasks.py run`, `python3 tasks.py
test`.

run [OVERRIDES]    the main job: `python -m pipeline +experiment=stringB method=robust OVERRIDES`, or another experiment
test [ARGUMENTS]   style, types and tests; arguments go to pytest
test --all         ... with the long ones
study NAME ...     a study of tests/benchmarks, such as diagnosis; arguments are its settings
bench              speed of simulations and of a diagnosis; see tests/benchmarks/speed
setup              only make the environment

The environment is `.venv`, made from `requirements.lock` and made again when that
changes. In it, the package `stringcast` is this clone.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ENVIRONMENT = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
BENCH_LOCK = ROOT / "tests" / "benchmarks" / "speed" / "requirements.lock"
PYTHON = ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
SIDE_BY_SIDE = ("--numprocesses=auto", "--dist=loadfile", "--no-loadscope-reorder")
# how the folders of this clone are one package
PACKAGE = (ROOT / "setup.py", ROOT / "pyproject.toml")
# the folders of this clone as one package, for Python, editors and mypy
LINKS = ENVIRONMENT / "package"
# by real clocks: they run beside one another alone, and wait most of the time
TIMED = "tests/drivers"
BY_CLOCKS = ("--numprocesses=3", "--dist=worksteal", TIMED)
MAIN = ("+experiment=stringB", "method=robust")  # of `run`
STYLE = (("ruff", "check", "."), ("ruff", "format", "--check", "."))


def main(arguments: list[str]) -> int:
    """Run one task; its exit status."""
    task, rest = (arguments[0], arguments[1:]) if arguments else ("help", [])
    if task not in TASKS:
        print(__doc__)
        return 0 if task in ("help", "-h", "--help") else 2
    setup()
    return TASKS[task](rest)


def setup() -> None:
    """Make `.venv` hold exactly what the lock says, and this clone as the package."""
    if sys.version_info < (3, 11):
        sys.exit(
            f"stringcast needs Python 3.11 or newer; this is {sys.version.split()[0]}. Run tasks.py with a newer one."
        )
    if ENVIRONMENT.is_symlink():
        sys.exit(
            f"{ENVIRONMENT} is a link to another clone's environment. Remove it: each clone has its own."
        )
    if not installed(LOCK):
        print("Setting up .venv (once; a minute or two) ...", flush=True)
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
        install("--require-hashes", "-r", LOCK, made_of=[LOCK])
    if not installed(*PACKAGE):
        install(
            "--no-deps", "--no-build-isolation", "--editable", ROOT, made_of=PACKAGE
        )
        # machine code names modules as they were called
        for stale in ROOT.rglob("__pycache__/*.nb[ci]"):
            stale.unlink()
    link_package()


def link_package() -> None:
    """Lay this clone out as the package `stringcast`, made of links, and put it on the
    environment's path.

    Editors, call graphs and mypy follow links, but not the import hook of an editable
    install. The hook stays for Windows without links, where only these tools miss the
    package.
    """
    folder = LINKS / "stringcast"
    folder.mkdir(parents=True, exist_ok=True)
    rooms = [ROOT / room for room in ("conf", "data", "hardware", "pipeline", "stages")]
    targets = {
        path.name: path for path in (*rooms, *(ROOT / "pipeline" / "api").glob("*.py*"))
    }
    for link in folder.iterdir():
        if link.name not in targets:
            link.unlink()
    for name, target in targets.items():
        try:
            (folder / name).symlink_to(target, target_is_directory=target.is_dir())
        except FileExistsError:
            continue
        except OSError:
            return
    for packages in ENVIRONMENT.glob("[Ll]ib/**/site-packages"):
        (packages / "stringcast.pth").write_text(f"{LINKS}\n", encoding="utf-8")


def mark(*files: Path) -> Path:
    """A file in the environment that says what of it was made of these files."""
    return (
        ENVIRONMENT
        / f"made-of-{files[0].relative_to(ROOT).as_posix().replace('/', '-')}"
    )


def digest(*files: Path) -> str:
    """A hash of files, this Python's version and this clone's place."""
    return hashlib.sha256(
        b"".join([sys.version.encode(), bytes(ROOT), *(f.read_bytes() for f in files)])
    ).hexdigest()


def installed(*files: Path) -> bool:
    """Whether the environment holds what is made of these files as they are now."""
    return mark(*files).exists() and mark(*files).read_text() == digest(*files)


def install(*what: str | Path, made_of: Sequence[Path]) -> None:
    """Install what pip is told, and note of which files it was made."""
    pip = [
        PYTHON,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        *what,
    ]
    if subprocess.run(pip, check=False).returncode:
        sys.exit(
            f"What {made_of[0].name} asks for could not be installed; see above. Is a package registry in reach?"
        )
    mark(*made_of).write_text(digest(*made_of))


def call(*command: str) -> int:
    """Run a module of the environment in the project's folder."""
    return subprocess.run([PYTHON, "-m", *command], cwd=ROOT, check=False).returncode


def run(rest: list[str]) -> int:
    """The pipeline: the main job with other settings, unless an experiment or a command
    is named.
    """
    named = rest and (
        "=" not in rest[0] or any(word.startswith("+experiment=") for word in rest)
    )
    default = [
        word
        for word in MAIN
        if not any(other.startswith(word.partition("=")[0] + "=") for other in rest)
    ]
    return call("pipeline", *([] if named else default), *rest)


def test(rest: list[str]) -> int:
    """Style, types, tests: all of them, and 0 only if each is clean. Files of tests run
    side by side, on all cores, and types are checked meanwhile: what goes by clocks
    must not have them beside it.
    """
    results = [call(*check) for check in STYLE]
    if rest not in ([], ["--all"]):
        return worst(*results, call("mypy"), call("pytest", *rest))
    which = ["-m", ""] if rest else []
    with ThreadPoolExecutor(1) as beside:
        types = beside.submit(call, "mypy")
        results.append(call("pytest", *SIDE_BY_SIDE, f"--ignore={TIMED}", *which))
        results.append(types.result())
    return worst(*results, call("pytest", *BY_CLOCKS, *which))


def worst(*codes: int) -> int:
    """0 if every command ended with 0, else 1: what a signal ended has a negative code,
    and pytest ends with 5 where it found no test.
    """
    return int(any(codes))


def study(rest: list[str]) -> int:
    """Run a study of tests/benchmarks, with PyElastica if that is the reference
    simulator.
    """
    if "diagnosis.simulator=pyelastica" in rest:
        install_peers()
    return call("tests.benchmarks", *rest)


def bench(rest: list[str]) -> int:
    """Run the speed benchmark, with the packages it compares with."""
    if rest != ["diagnosis"]:
        install_peers()
    return call("tests.benchmarks.speed.bench", *rest)


def install_peers() -> None:
    """Install MuJoCo and PyElastica."""
    if not installed(BENCH_LOCK):
        install("--require-hashes", "-r", BENCH_LOCK, made_of=[BENCH_LOCK])


TASKS = {
    "run": run,
    "test": test,
    "study": study,
    "bench": bench,
    "setup": lambda rest: 0,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
