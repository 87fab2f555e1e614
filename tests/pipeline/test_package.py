"""The folders of a clone are one package.

A wheel holds all of it, installs nothing else, and runs anywhere.
"""

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
    """Return a folder in which the wheel is unpacked, as in site-packages."""
    folder = tmp_path_factory.mktemp("wheel")
    clone = folder / "clone"
    subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
    made = [
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
    subprocess.run([sys.executable, "-m", *made], check=True)
    zipfile.ZipFile(next(folder.glob("*.whl"))).extractall(folder / "site")
    return folder / "site"


def test_all_that_a_clone_holds_is_in_the_one_package(site):
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


def test_what_is_installed_runs_in_any_folder(site, tmp_path):
    """The installed package runs in any folder.

    It stands ahead of this clone on the path. Settings compose from it, a command
    answers, and no folder of ours is needed.
    """
    where = os.environ | {
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
    done = subprocess.run(
        call, cwd=tmp_path, env=where, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == [
        stringcast.__version__,
        str(site / "stringcast" / "__init__.py"),
        "5",
    ]
    assert done.returncode == 1
    assert done.stderr.startswith("Error: ")
    assert "target.x" in done.stderr
    assert "Traceback" not in done.stderr


def test_only_an_arm_needs_pyserial_and_says_so(tmp_path):
    """Without the extra `lab`, all that drives no arm is there."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nsys.modules.update(serial=None)\n"
    )
    where = os.environ | {
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
    options = {"cwd": tmp_path, "env": where, "capture_output": True, "text": True}
    done = subprocess.run(python, **options, check=False)
    count, error = done.stdout.splitlines()
    assert count == "5"
    assert 'pip install "stringcast[lab]"' in error


def test_versions_name_packages_that_are_absent():
    assert package_version("no-such-package") == "absent"
    assert package_version("numpy")[0].isdigit()


def test_the_release_says_what_an_index_and_a_citation_need():
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


def test_the_wheel_is_small(site):
    (wheel,) = site.parent.glob("*.whl")
    assert wheel.stat().st_size < 1.5e6
    assert (site / "stringcast" / "py.typed").is_file()


def test_the_clone_runs_as_itself_and_not_as_another(tmp_path):
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


def test_rooms_are_imported_by_the_name_of_the_package_alone():
    """Rooms are imported by the name of the package alone.

    `stages.model` and `stringcast.stages.model` would be two modules of one file.
    """
    rooms = "|".join(ROOMS)
    import_of_a_room = re.compile(rf"^\s*(from|import)\s(.*,)?\s*({rooms})\b", re.M)
    for file in [
        path for room in (*ROOMS, "tests") for path in (ROOT / room).rglob("*.py")
    ]:
        text = file.read_text(encoding="utf-8")
        # to parse a file takes long
        tree = ast.parse(text if import_of_a_room.search(text) else "")
        for node in ast.walk(tree):
            named = [node.module] if isinstance(node, ast.ImportFrom) else []
            named = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else named
            )
            assert not {str(name).split(".")[0] for name in named} & set(ROOMS), file
