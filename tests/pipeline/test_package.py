"""The folders of a clone are one package; its wheel is complete and runs anywhere."""

import ast
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import stringcast
from stringcast.pipeline.run.provenance import package_version

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("conf", "data", "hardware", "pipeline", "stages")
LEFT_OUT = (
    "data/results/",
    "data/tutorial/",
    "data/ground_truth/",
    "hardware/serial/device/",
    "pipeline/api/",
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return a folder with the unpacked wheel, as in site-packages."""
    folder = tmp_path_factory.mktemp("wheel")
    clone = folder / "clone"
    subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
    pip_wheel = [
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "--disable-pip-version-check",
        "-w",
        folder,
        clone,
    ]
    subprocess.run([sys.executable, "-m", *pip_wheel], check=True)
    zipfile.ZipFile(next(folder.glob("*.whl"))).extractall(folder / "site")
    return folder / "site"


def test_wheel_holds_all_files_of_the_clone(site):
    assert {
        path.name for path in site.iterdir() if not path.name.endswith(".dist-info")
    } == {
        "stringcast",
        "hydra_plugins",
    }
    tracked = subprocess.run(
        ["git", "ls-tree", "-r", "--name-only", "HEAD", *ROOMS],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    wanted = [name for name in tracked.splitlines() if not name.startswith(LEFT_OUT)]
    assert len(wanted) > 400
    assert [name for name in wanted if not (site / "stringcast" / name).is_file()] == []


def test_installed_package_runs_in_any_folder(site, tmp_path):
    """It precedes this clone on the path, and needs no folder of the clone."""
    environment = os.environ | {
        "PYTHONPATH": str(site),
        "STRINGCAST_CACHE": str(tmp_path / "kernels"),
    }
    code = (
        "import runpy, stringcast\n"
        "print(stringcast.__version__, stringcast.__file__, len(stringcast.sample()))\n"
        "runpy.run_module('stringcast', run_name='__main__', alter_sys=True)"
    )
    call = [
        *(sys.executable, "-c", code),
        *("target.x=2", f"hydra.run.dir={tmp_path / 'run'}"),
    ]
    result = subprocess.run(
        call, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert result.stdout.split() == [
        stringcast.__version__,
        str(site / "stringcast" / "__init__.py"),
        "5",
    ]
    assert result.returncode == 1
    assert result.stderr.startswith("Error: ")
    assert "target.x" in result.stderr
    assert "Traceback" not in result.stderr


def test_pyserial_is_needed_for_an_arm_only(tmp_path):
    """Without the extra `lab`, everything except arms works."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nsys.modules.update(serial=None)\n"
    )
    environment = os.environ | {
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    }
    code = (
        "import stringcast as sc\n"
        "from stringcast.hardware.serial import lab, wire\n"
        "print(len(sc.sample()))\n"
        "try:\n    wire.serial.Serial\n"
        "except sc.StringcastError as error:\n    print(error)"
    )
    python = [sys.executable, "-c", code]
    options = {
        "cwd": tmp_path,
        "env": environment,
        "capture_output": True,
        "text": True,
    }
    result = subprocess.run(python, **options, check=False)
    count, error = result.stdout.splitlines()
    assert count == "5"
    assert "pip install pyserial" in error


def test_missing_packages_have_the_version_absent():
    assert package_version("no-such-package") == "absent"
    assert package_version("numpy")[0].isdigit()


def test_release_metadata_are_complete():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    core = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}
    assert "pyserial" not in core
    lab = " ".join(project["optional-dependencies"]["lab"])
    assert "pyserial" in lab
    assert {"Homepage", "Documentation", "Repository", "Issues"} <= set(project["urls"])
    assert f"version: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()
    lock = (ROOT / "requirements.lock").read_text()
    missing = [name for name in core if f"\n{name}==" not in lock.lower()]
    assert missing == []


def test_wheel_is_small(site):
    (wheel,) = site.parent.glob("*.whl")
    assert wheel.stat().st_size < 1.5e6
    assert (site / "stringcast" / "py.typed").is_file()


def test_clone_refuses_the_package_of_another_clone(tmp_path):
    for name in ("pipeline/__init__.py", "pipeline/__main__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    call = [sys.executable, "-m", "pipeline", "--help"]
    refused = subprocess.run(
        call, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert refused.returncode == 1
    assert (
        f"its stringcast is that of {ROOT}. Run python3 tasks.py setup here"
        in refused.stderr
    )


def test_rooms_are_imported_only_through_the_package():
    """`stages.model` and `stringcast.stages.model` would be two modules of one file."""
    rooms = "|".join(ROOMS)
    import_of_a_room = re.compile(rf"^\s*(from|import)\s(.*,)?\s*({rooms})\b", re.M)
    for file in [
        path for room in (*ROOMS, "tests") for path in (ROOT / room).rglob("*.py")
    ]:
        text = file.read_text(encoding="utf-8")
        # parsing a file is slow
        tree = ast.parse(text if import_of_a_room.search(text) else "")
        for node in ast.walk(tree):
            named = [node.module] if isinstance(node, ast.ImportFrom) else []
            named = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else named
            )
            assert not {str(name).split(".")[0] for name in named} & set(ROOMS), file
