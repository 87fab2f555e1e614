"""Set up and run the project with nothing but Python: `python3 tasks.py TASK ...`.

run [OVERRIDES]    the main job, or another experiment or command:
                   `python -m pipeline +experiment=stringB method=adaptive OVERRIDES`
test [ARGUMENTS]   style, types and tests; arguments go to pytest
test --all         the same with the long tests
study NAME ...     a study of tests/benchmarks, such as diagnosis, with its settings
bench              speed of simulations and of a diagnosis; see tests/benchmarks/speed
docs               the site, in docs/site; a warning is an error
package            source archive and wheel in dist, both checked
setup              make the environment and compile the loops of the simulation

The environment is `.venv`, made from `requirements.lock` and made again when that file
changes. In it, the package `stringcast` is this clone.
"""

from __future__ import annotations

import hashlib
import os
import shutil
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
DOCS_LOCK = ROOT / "docs" / "requirements.lock"
PYTHON = ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
# files that define the package
PACKAGE_FILES = (ROOT / "setup.py", ROOT / "pyproject.toml")
# the folders of this clone as one package, for Python, editors and mypy
LINKS = ENVIRONMENT / "package"
PARALLEL_OPTIONS = ("--numprocesses=auto", "--dist=loadfile", "--no-loadscope-reorder")
# These tests depend on real clocks, so nothing else may run meanwhile.
TIMED_TESTS = "tests/drivers"
TIMED_OPTIONS = ("--numprocesses=3", "--dist=worksteal", TIMED_TESTS)
STYLE_CHECKS = (("ruff", "check", "."), ("ruff", "format", "--check", "."))


def main(arguments: list[str]) -> int:
    """Run one task and return its exit status."""
    task = arguments[0] if arguments else "help"
    if task not in TASKS:
        print(__doc__)
        return 0 if task in ("help", "-h", "--help") else 2
    prepare_environment()
    return TASKS[task](arguments[1:])


def prepare_environment() -> None:
    """Make `.venv` match the lock file, with this clone as the package."""
    if sys.version_info < (3, 11):
        sys.exit(
            f"stringcast needs Python 3.11 or newer; this is {sys.version.split()[0]}. "
            "Run tasks.py with a newer one."
        )
    if ENVIRONMENT.is_symlink():
        sys.exit(
            f"{ENVIRONMENT} is a link to another clone's environment. "
            "Remove it: each clone has its own."
        )
    if not is_installed(LOCK):
        print("Setting up .venv (once; a minute or two) ...", flush=True)
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
        install_lock(LOCK)
    is_new = not is_installed(*PACKAGE_FILES)
    if is_new:
        options = ("--no-deps", "--no-build-isolation", "--editable", ROOT)
        install_packages(*options, sources=PACKAGE_FILES)
        # Compiled kernels hold old names of modules.
        for kernel in ROOT.rglob("__pycache__/*.nb[ci]"):
            kernel.unlink()
    link_package()
    if is_new:
        compile_loops()


def link_package() -> None:
    """Put the package `stringcast`, made of links, on the environment's path.

    Editors, call graphs and mypy follow links, but not the import hook of an editable
    install. Windows without links needs the hook; these tools miss the package there.
    """
    folder = LINKS / "stringcast"
    folder.mkdir(parents=True, exist_ok=True)
    rooms = [ROOT / room for room in ("conf", "data", "hardware", "pipeline", "stages")]
    modules = (ROOT / "pipeline" / "api").glob("*.py*")
    targets = {path.name: path for path in (*rooms, *modules)}
    for path in folder.iterdir():
        # Python keeps its bytecode in a folder beside the links
        if path.is_symlink() and path.name not in targets:
            path.unlink()
    for name, target in targets.items():
        try:
            (folder / name).symlink_to(target, target_is_directory=target.is_dir())
        except FileExistsError:
            continue
        except OSError:
            return
    for packages in ENVIRONMENT.glob("[Ll]ib/**/site-packages"):
        (packages / "stringcast.pth").write_text(f"{LINKS}\n", encoding="utf-8")


def digest_file(sources: Sequence[Path]) -> Path:
    """Return the file in the environment that holds the digest of installed sources."""
    name = sources[0].relative_to(ROOT).as_posix().replace("/", "-")
    return ENVIRONMENT / f"made-of-{name}"


def compute_digest(sources: Sequence[Path]) -> str:
    """Return a hash of files, the Python version and the path of this clone."""
    digest = hashlib.sha256(sys.version.encode() + bytes(ROOT))
    for file in sources:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def is_installed(*sources: Path) -> bool:
    """Return whether the environment was made from the present content of files."""
    file = digest_file(sources)
    return file.exists() and file.read_text() == compute_digest(sources)


def install_packages(*options: str | Path, sources: Sequence[Path]) -> None:
    """Run pip, and store the digest of the files that name the packages."""
    pip = (PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    if subprocess.run([*pip, *options], check=False).returncode:
        sys.exit(
            f"The packages of {sources[0].name} could not be installed; see above. "
            "Can a package registry be reached from here?"
        )
    digest_file(sources).write_text(compute_digest(sources))


def install_lock(lock: Path) -> None:
    """Install exactly the packages of a lock file."""
    install_packages("--require-hashes", "-r", lock, sources=[lock])


def run_module(*command: str) -> int:
    """Run a module of the environment in the project's folder; return its status."""
    return subprocess.run([PYTHON, "-m", *command], cwd=ROOT, check=False).returncode


def compile_loops(arguments: Sequence[str] = ()) -> int:
    """Compile the loops of the simulation, so that no first run waits for it."""
    return run_module("stringcast.stages.model.engine.compile_loops", *arguments)


def run_pipeline(arguments: list[str]) -> int:
    """Run the main job with other settings, or the experiment or command given."""
    is_command = bool(arguments) and "=" not in arguments[0]
    given = {word.partition("=")[0] for word in arguments}
    defaults = []
    if not is_command and "+experiment" not in given:
        defaults.append("+experiment=stringB")
        if "method" not in given:
            defaults.append("method=adaptive")
    return run_module("pipeline", *defaults, *arguments)


def run_tests(arguments: list[str]) -> int:
    """Check style, types and tests; return 0 only if each of them is clean.

    Files of tests run in parallel on all cores, and types are checked meanwhile. Tests
    that wait for real clocks run afterwards. A signal gives a negative status, and
    pytest ends with 5 if it found no test.
    """
    # Otherwise each process of the tests compiles all modules again.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    statuses = [run_module(*check) for check in STYLE_CHECKS]
    if arguments not in ([], ["--all"]):
        statuses += [run_module("mypy"), run_module("pytest", *arguments)]
        return int(any(statuses))

    selection = ["-m", ""] if arguments else []
    untimed = (*PARALLEL_OPTIONS, f"--ignore={TIMED_TESTS}", *selection)
    with ThreadPoolExecutor(1) as executor:
        types = executor.submit(run_module, "mypy")
        statuses += [run_module("pytest", *untimed), types.result()]
    if os.name == "nt":
        print("Not run on Windows: emulated arms, killed processes and sweeps.")
    else:
        statuses.append(run_module("pytest", *TIMED_OPTIONS, *selection))
    return int(any(statuses))


def run_study(arguments: list[str]) -> int:
    """Run a study of tests/benchmarks; install PyElastica if the study needs it."""
    if any(argument.endswith(".simulator=pyelastica") for argument in arguments):
        install_peers()
    return run_module("tests.benchmarks", *arguments)


def run_benchmark(arguments: list[str]) -> int:
    """Run the speed benchmark; install the packages for comparison."""
    if arguments != ["diagnosis"]:
        install_peers()
    return run_module("tests.benchmarks.speed.bench", *arguments)


def install_peers() -> None:
    """Install MuJoCo and PyElastica."""
    if not is_installed(BENCH_LOCK):
        install_lock(BENCH_LOCK)


def build_site(arguments: list[str]) -> int:
    """Build the site from the pages and the docstrings."""
    if not is_installed(DOCS_LOCK):
        install_lock(DOCS_LOCK)
    return run_module("docs.build", *arguments)


def build_package(arguments: list[str]) -> int:
    """Build source archive and wheel, and check their metadata and content."""
    if not is_installed(DOCS_LOCK):
        install_lock(DOCS_LOCK)
    folder = ROOT / "dist"
    shutil.rmtree(folder, ignore_errors=True)
    status = run_module("build", "--outdir", str(folder), *arguments)
    archives = [str(path) for path in sorted(folder.glob("stringcast-*"))]
    wheels = [archive for archive in archives if archive.endswith(".whl")]
    checks = (
        ("twine", "check", "--strict", *archives),
        ("check_wheel_contents", *wheels),
    )
    return status or max(run_module(*check) for check in checks)


TASKS = {
    "run": run_pipeline,
    "test": run_tests,
    "study": run_study,
    "bench": run_benchmark,
    "docs": build_site,
    "package": build_package,
    "setup": compile_loops,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
