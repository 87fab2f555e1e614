"""All commands on pages run and do what the page states.

Quick commands that no other test runs are run by default, all others by `test --all`.
Commands of over ten minutes are run with smaller settings (`less`). Commands that
another test runs, or that need a device, a person or another machine, are listed with
the reason; `pytest -rs` prints it.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
import pytest

from stringcast.pipeline.commands import new
from tests.calibration.studio import picture, pose, tilted
from tests.pipeline.test_readme_commands import ROOT, find_in_code

COMMAND = re.compile(
    r"(?:\.venv/bin/)?python3? (?:-m )?((?:pipeline|stringcast|tests|pytest|pip|tasks\.py)\b[\w.]*)(.*)"
)
ROOMS = ("conf", "data", "hardware", "pipeline", "stages")
PAPER = (
    "report.html",
    "runs.parquet",
    "casts.parquet",
    "rates.parquet",
    "needed.parquet",
    "numbers.parquet",
    "*.png",
)


@dataclass(frozen=True)
class Run:
    """How to run a command of a page, and what to expect.

    says: pattern in the output. leaves: files in its folder. rows: a table there and
    its number of rows. less: settings that make it smaller. of: replaces outputs/... .
    long: over 20 s, or run by default elsewhere.
    """

    says: str = ""
    leaves: tuple[str, ...] = ()
    rows: tuple[str, int] = ("", 0)
    less: str = ""
    of: str = "cast"
    long: bool = True


CAST = {
    "says": r"report\.html$",
    "leaves": ("report.html", "run.json", "dataset.yaml", "iterations/01/estimate"),
}
DIAGNOSED = {"leaves": ("report.html", "diagnosis.json", "extended.yaml")}
CASTS = ("casts.parquet", "rates.parquet", "needed.parquet", "hits.png")
LESS_CASTING = "casting.seeds=1 casting.casts=2 ~casting.cases.B ~casting.cases.C ~casting.cases.D ~casting.cases.wall"
RUN = {
    "tasks.py run": Run(**CAST),
    "pipeline +experiment=stringB": Run(**CAST),
    "pipeline +experiment=stringB method=robust": Run(**CAST),
    "pipeline +experiment=window": Run(**CAST),
    "pipeline +experiment=adaptive specimen=C target=at_500_900 +specimen.hidden.tip_mass.ratio=0.3": Run(
        **CAST
    ),
    "pipeline method=robust specimen=B target=at_400_700 target.w=0.0005 target.h=0.0005 max_casts=4 seed=7 +specimen.hidden.tip_mass.ratio=0.3": Run(
        **CAST
    ),
    "pipeline target.x=0.45 target.y=0.65 seed=3": Run(**CAST),
    "pipeline 'effects=[tip_mass,arm_lag]'": Run(**CAST),
    "pipeline +experiment=stringB seed=0 hydra.run.dir=outputs/gallery": Run(**CAST),
    "pipeline model_from=outputs/...": Run(**CAST, of="diagnosed"),
    "pipeline +experiment=stringB model_from=outputs/...-align-...": Run(
        **CAST, of="aligned"
    ),
    "pipeline +experiment=diagnose trials=data/sample": Run(
        r"report\.html$", **DIAGNOSED
    ),
    "pipeline +experiment=diagnose trials=outputs/...": Run(**DIAGNOSED),
    "pipeline +experiment=diagnose trials=<folder>": Run(**DIAGNOSED, of="mine"),
    "pipeline +experiment=diagnose trials=mine": Run(**DIAGNOSED, of="mine"),
    "pipeline +experiment=decide trials=outputs/...": Run(**DIAGNOSED),
    "pipeline +experiment=estimate trials=outputs/...": Run(
        leaves=("report.html", "run.json")
    ),
    **{
        f"pipeline +experiment=estimate estimate=least_squares {words} trials=<folder>": Run(
            leaves=("report.html", "run.json"), of="mine"
        )
        for words in (
            "trials_used=all",
            "trials_used=all 'effects=[rest_curvature,maxwell_slip]'",
            "'effects=[tip_mass]' +parameter_values.tip_mass.ratio=0.05",
            "'+parameter_values.bending_stiffness={value: 20, low: 15, high: 25}'",
        )
    },
    "pipeline +experiment=align": Run(leaves=("report.html", "extended.yaml")),
    "pipeline +experiment=align trials=outputs/...": Run(
        leaves=("report.html", "extended.yaml")
    ),
    "pipeline +experiment=calibrate source=images source.folder=tilted plane.folder=flat": Run(
        leaves=("report.html", "camera.yaml", "calibration"), of="pictures"
    ),
    "pipeline +experiment=calibrate source=video source.path=tilted.mp4 plane.folder=flat": Run(
        leaves=("report.html", "camera.yaml", "calibration"), of="pictures"
    ),
    # Sweeps; a job takes about half a minute.
    "pipeline --multirun method=paper estimate.beta=0.99,0.995 target=at_300_900,at_400_700 seed=0,1,2": Run(
        leaves=("report.html", "ledger"), rows=("sweep.parquet", 12)
    ),
    "pipeline --multirun +experiment=stringB estimate.beta=0.99,0.995 seed=0,1,2": Run(
        leaves=("report.html", "ledger"), rows=("sweep.parquet", 6)
    ),
    # one run of 45 jobs
    "pipeline +experiment=sweep": Run(
        leaves=("report.html",), rows=("sweep.parquet", 9), less="seed=0"
    ),
    "pipeline +experiment=paper name=wall": Run(
        leaves=PAPER, rows=("runs.parquet", 1), less="seed=0"
    ),
    "pipeline +experiment=paper": Run(
        leaves=PAPER,
        rows=("runs.parquet", 2),
        less="seed=0 name=A_300_900,wall",
    ),  # 2 of 450 runs
    "pipeline +experiment=paper 'seed=range(2)'": Run(
        leaves=PAPER, rows=("runs.parquet", 2), less="name=A_300_900"
    ),  # 2 of 30 runs
    "pipeline +experiment=paper 'seed=range(3)'": Run(
        leaves=PAPER, rows=("runs.parquet", 3), less="name=A_300_900"
    ),  # 3 of 45 runs
    # Studies; each takes hours.
    "tasks.py study diagnosis diagnosis.simulator=nodal seed=100": Run(
        "cause found",
        ("diagnoses.parquet", "rates.parquet"),
        ("diagnoses.parquet", 1),
        "diagnosis.datasets=1",
    ),
    "tasks.py study casting": Run("Hit: paper", CASTS, less=LESS_CASTING),
    "tasks.py study extraction extraction.frames=24": Run(
        r"2064 frames: 7\d\.\d% read, 0\.\d+% wrong",
        ("shares.parquet", "frames.parquet"),
    ),
    # Commands that overwrite stored files run in a copy of the project.
    "tests.convergence.table": Run(r"\| A \| 3 \| semi_implicit_euler \|"),
    # Commands with a plugin.
    "pipeline 'plugins=[my_lab]' +experiment=quick 'effects=[side_pull]' estimate=uniform_search": Run(
        **CAST, of="my_lab"
    ),
    "pipeline 'plugins=[my_lab]' +sway=plain mode=batch mode.stage=sway trials=data/sample": Run(
        "The tip moves by at most", ("report.html",), of="my_lab", long=False
    ),
    # Commands on stored runs.
    "pipeline graph +experiment=stringB": Run("estimate: takes trial of execute"),
    "pipeline index --to runs.parquet": Run(r"run +ended as +casts"),
}
TEN_MINUTES = (
    "tests/pipeline/test_readme_commands.py::test_first_ten_minutes_run_as_on_the_page"
)
SHORT = (
    "tests/pipeline/test_readme_commands.py::test_short_commands_of_the_front_page_work"
)
ELSEWHERE = {  # command: the test that runs it, or why no test can
    "pipeline import robot_*.csv tracker_*.csv --to mine --length 304mm --links 0.25,0.20,0.135 --base 0.2,0.2": "tests/"
    "importing/test_import.py::test_robot_and_tracker_logs_become_a_dataset",
    "pipeline import data/tutorial/robot_*.csv data/tutorial/tracker_*.csv --to mine --length 282mm "
    "--links 0.25,0.20,0.135 --base 0.2,0.2": "tests/importing/test_import.py::test_import_of_the_tutorial_prints_what_its_page_shows",
    "pipeline check mine --report check.html": "tests/checking/test_check.py::test_a_page_shows_measurements_and_findings",
    "pipeline new stage sway": "tests/pipeline/test_new_stage.py::test_new_stage_runs_and_is_reported",
    "pipeline check mine": TEN_MINUTES,
    "pipeline check wrong": TEN_MINUTES,
    "pipeline check data/sample": SHORT,
    "pipeline board board.pdf": SHORT,
    "pipeline --help": SHORT,
    "pipeline.settings.reference": "would write over the page: tests/pipeline/test_help.py::test_settings_reference_is_up_to_date",
    "pipeline +experiment=paper hydra.sweep.dir=outputs/sweeps/...": "goes on with a sweep, as does "
    "tests/sweep/test_sweep_command.py::test_repeated_command_runs_missing_jobs_and_failed_ones_on_request",
    "tasks.py study draw 7 riddle riddle.json": "tests/benchmarks/test_drawing.py",
    "tasks.py study draw 7 riddle riddle.json --simulator nodal": "as own_kernel",
    "tasks.py study diagnosis": "takes days; as with a seed",
    "pipeline new effect side_pull": "tests/pipeline/test_new.py",
    "pipeline new estimator uniform_search": "tests/pipeline/test_new.py",
    "pipeline why outputs/...": "with a folder of one's own: tests/pipeline/test_plugins.py::test_plugin_effect_stage_and_estimator_take_part_in_a_run",
    "stringcast.stages.model.engine.print_loop [EFFECT ...]": "tests/laws/test_generated_loop.py",
    "pytest tests/laws/test_effects.py": "is one of the tests",
    "tasks.py test --all": "is what runs this",
    "pipeline +experiment=calibrate source=device source@plane=device": "needs a camera and a person with a board",
    "pipeline +experiment=stringB hardware=serial camera_from=outputs/...": "needs an arm on a serial port; with an "
    "emulated one: tests/drivers/test_run_interrupted.py",
    "stringcast.hardware.serial.clear PORT": "asks a person; typed in for him: tests/drivers/test_serial_link.py",
    "stringcast.hardware.dynamixel.clear PORT ID ...": "asks a person; typed in: tests/drivers/test_dynamixel.py",
    "stringcast.hardware.serial.emulator [--log FILE] [--fault KIND:N ...]": "tests/drivers/rig.py::emulator",
    "stringcast.hardware.dynamixel.emulator [--fault KIND:N ...]": "tests/drivers/test_dynamixel.py::bus",
    "tasks.py study diagnosis diagnosis.simulator=nodal seed=100 diagnosis.datasets=10": "as without datasets",
    "tasks.py study diagnosis diagnosis.simulator=nodal diagnosis.kind=none diagnosis.datasets=100": "as with a seed",
    "tasks.py study diagnosis diagnosis.simulator=own_kernel diagnosis.kind=mixed string=paper seed=4148 diagnosis.datasets=12": "as with a seed",
    "tasks.py study casting casting.seeds=16": "takes hours; one run of it: tests/benchmarks/casting/test_casting_study.py",
    "tasks.py study casting ~casting.methods.paper casting.first=310 casting.seeds=10 casting.casts=1": "takes minutes; one run of it: tests/benchmarks/casting/test_casting_study.py",
    "tasks.py study gain casting.seeds=2": "takes hours; as casting",
    "pipeline +experiment=adaptive specimen=D target=at_500_900 seed=987 max_casts=3 +specimen.hidden.joint_gain.gain=0.04 +specimen.hidden.rest_curvature.curvature=3.0": "takes two minutes; as adaptive with a heavy tip",
    "tasks.py study adaptive casting.first=968 casting.seeds=1 casting.casts=2 ~casting.methods.robust ~casting.methods.informed": "takes a quarter of an hour; its jobs: tests/benchmarks/casting/test_casting_study.py",
    "tasks.py study adaptive casting.first=952 casting.seeds=2 casting.casts=2 ~casting.methods.robust ~casting.methods.informed": "takes half an hour; its jobs: tests/benchmarks/casting/test_casting_study.py",
    "tasks.py study worlds casting.first=800 casting.seeds=1 ~casting.methods.robust ~casting.cases.C ~casting.cases.D": "takes half an hour; its jobs: tests/benchmarks/casting/test_casting_study.py",
    "tasks.py study worlds casting.first=830 casting.seeds=1 ~casting.methods.adaptive ~casting.cases.C ~casting.cases.D look=null casting.casts=3": "as with seed 800",
    "tasks.py study forecast casting.first=1300 casting.seeds=33": "takes an hour; as adaptive",
    "tasks.py study practice casting.first=802 casting.seeds=2 casting.training.casts=8": "takes ten minutes; as adaptive",
    "tasks.py study learning casting.seeds=3": "takes hours; as casting",
    "tasks.py study clocks": "takes half an hour; its summary: "
    "tests/benchmarks/clocks/test_clocks_study.py",
    "tasks.py study alignment": "rewrites its recorded table: tests/benchmarks/test_main.py",
    "tasks.py study footage ../shared/measured outputs/footage.parquet": "needs films of others, which may not be "
    "handed on",
    "tasks.py study measured measured.source=../shared/measured": "needs recordings of others; a small one: "
    "tests/benchmarks/measured/test_measured_study.py",
    "tasks.py study strings ../shared/measured 75mm 100mm black_short_unweighted "
    "black_unweighted orange_short_unweighted --seeds 2": "needs "
    "recordings of others, which may not be handed on",
    "tasks.py test": "is what runs this",
    "tasks.py setup": "made the environment that this runs in",
    "tasks.py docs": "installs what builds the site: tests/pipeline/test_site.py",
    "tasks.py package": "installs what checks archives; the wheel: tests/pipeline/"
    "test_package.py",
    "tasks.py bench": "installs what it compares with; a small one: "
    "tests/benchmarks/speed/test_speed.py",
    "tasks.py bench diagnosis": "as bench; a diagnosis of the sample runs elsewhere",
    "pip install dynamixel-sdk": "installs",
    "pipeline": "how commands begin: tests/pipeline/test_command_line.py",
}


def shown_commands():
    """Return all commands on pages, without comments."""
    return {
        f"{found[1]} {found[2].partition(' #')[0].strip()}".strip()
        for _, found in find_in_code(COMMAND)
    }


def test_all_commands_on_pages_are_run_or_excused():
    known = {*RUN, *ELSEWHERE}
    assert shown_commands() - known == set(), "shown by a page, and run nowhere"
    assert known - shown_commands() == set(), "shown by no page any more"
    assert not {*RUN} & {*ELSEWHERE}


@pytest.mark.parametrize("command", ELSEWHERE)
def test_commands_run_by_other_tests_or_not_at_all(command):
    reason = ELSEWHERE[command]
    for file, name in re.findall(r"(tests/[\w/]+\.py)(?:::(\w+))?", reason):
        assert f"def {name}" in (ROOT / file).read_text()
    pytest.skip(f"{command}: {reason}")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder for inputs that all tests share."""
    return tmp_path_factory.mktemp("pages")


def run_shown(words, cwd=ROOT):
    """Return the command's exit status and output, in one line."""
    environment = os.environ | {"PYTHONPATH": str(cwd / ".package")}
    command = [sys.executable, "-m", *words]
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    return done.returncode, " ".join((done.stdout + done.stderr).split())


def copy_project(folder):
    """Copy the last commit into a folder, for commands that overwrite stored files."""
    subprocess.run(["git", "clone", "-q", ROOT, folder], check=True)
    package = folder / ".package" / "stringcast"
    package.mkdir(parents=True)
    for part in [
        *(folder / "pipeline" / "api").glob("*.py"),
        *map(folder.joinpath, ROOMS),
    ]:
        (package / part.name).symlink_to(part)
    return folder


def make_input(place, name):
    """Make the input of a command: a cast, a diagnosis, measurements, pictures, ..."""
    folder = place / name
    if folder.exists():
        return folder
    words = {
        "cast": [
            "+experiment=quick",
            "max_casts=2",
            "target.w=0.02",
            "target.h=0.04",
        ],
        "diagnosed": ["+experiment=diagnose", "trials=data/sample"],
        "aligned": ["+experiment=align"],
    }
    if name in words:
        status, output = run_shown(
            ["pipeline", *words[name], f"hydra.run.dir={folder}"]
        )
        assert status == 0, output
    elif name == "my_lab":
        for kind, of in (
            ("effect", "side_pull"),
            ("stage", "sway"),
            ("estimator", "uniform_search"),
        ):
            assert new.main([kind, of, "--to", str(folder)]) == 0
    elif name == "mine":
        shutil.copytree(ROOT / "data" / "sample", folder)
    else:
        render_pictures(folder)
    return folder


def render_pictures(folder):
    """Render pictures and a film of a tilted board, and a picture in the plane."""
    rng = np.random.default_rng(0)
    (folder / "tilted").mkdir(parents=True)
    (folder / "flat").mkdir()
    images = tilted(rng)
    rows, columns = images[0].shape
    film = cv2.VideoWriter(
        str(folder / "tilted.mp4"),
        cv2.VideoWriter.fourcc(*"mp4v"),
        2.0,
        (columns, rows),
    )
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / "tilted" / f"{number:02d}.png"), image)
        for _ in range(15):  # `source.every` reads one of so many frames
            film.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    film.release()
    cv2.imwrite(
        str(folder / "flat" / "0.png"),
        picture(*pose(0.0, 0.0, 0.0, 0.0, 0.05, 0.42), rng),
    )


def fill_placeholders(command, run, place, out):
    """Return the words of the command, with placeholders replaced."""
    words = shlex.split(f"{command} {run.less}")
    needed = re.search(
        r"outputs/\.\.\.|<|tilted|outputs/gallery/|trials=mine|my_lab", command
    )
    folder = make_input(place, run.of) if needed else place
    words = [
        re.sub(
            r"outputs/\.\.\.[\w.-]*|<[^>]*>|outputs/gallery(?=/)|(?<==)mine$|my_lab",
            str(folder),
            word,
        )
        for word in words
    ]
    words = [
        re.sub(r"(?<==)(tilted\.mp4|tilted|flat)$", rf"{folder}/\1", word)
        for word in words
    ]
    if words[:2] == ["tasks.py", "study"]:
        return ["tests.benchmarks", *words[2:], f"folder={out}"]
    if words[0] == "tasks.py":
        words = ["pipeline", "+experiment=stringB"]
    if any(re.match(r"[+~\w./@]+=", word) for word in words) and words[0] == "pipeline":
        several = "--multirun" in words or re.search(
            r"=(paper|sweep)$", " ".join(words[:2])
        )
        words = [word for word in words if not word.startswith("hydra.run.dir=")]
        return [*words, f"hydra.{'sweep' if several else 'run'}.dir={out}"]
    return [
        re.sub(
            r"^(board\.pdf|riddle|riddle\.json|runs\.parquet|string\.xml)$",
            rf"{out}-\1",
            word,
        )
        for word in words
    ]


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(command, marks=[pytest.mark.long] * run.long)
        for command, run in RUN.items()
    ],
)
def test_commands_do_what_their_page_states(command, place, tmp_path):
    run, out = RUN[command], tmp_path / "out"
    cwd = ROOT
    if command.startswith(("tests.", "pipeline.")):
        cwd = copy_project(tmp_path / "project")
    words = fill_placeholders(command, run, place, out)
    if command.startswith("pipeline index"):
        words.insert(2, str(make_input(place, "cast").parent))
    status, output = run_shown(words, cwd)
    assert status == 0, output[-3000:]
    assert "Traceback" not in output
    assert re.search(run.says, output), output[-3000:]
    for file in run.leaves:
        assert list(out.glob(file)), f"{file} is missing; there are {os.listdir(out)}"
    table, rows = run.rows
    assert not table or len(pd.read_parquet(out / table)) == rows
