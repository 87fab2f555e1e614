"""Fixtures of several tests: the default world, and trials filmed once.

What takes long to import is imported where it is used. Controllers of parallel workers
and tests of drivers need little of it, and all would take 2 s of each process.
"""

from __future__ import annotations

import gc
import io
import os
import pickle
import shutil
import subprocess
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
import yaml

import stringcast
from stringcast.stages.plugins import PLUGINS_VARIABLE

if TYPE_CHECKING:
    import numpy as np

    from stringcast.data.artifacts import Motion
    from stringcast.hardware.virtual.bench import Specimen
    from stringcast.stages.model.arm import Arm
    from stringcast.stages.model.camera import Camera
    from stringcast.stages.model.model import Model
    from stringcast.stages.model.string import String

ROOT = Path(__file__).resolve().parents[1]
if not Path(stringcast.__file__).resolve().is_relative_to(ROOT):
    raise pytest.UsageError(
        f"{stringcast.__file__} is not this clone's package. Run python3 tasks.py setup here."
    )
# An ordinary string, the paper's parameters per mass point at n = 10.
TRUTH = {
    "bending_stiffness": 4.0,
    "bending_damping": 5e-3,
    "linear_drag": 0.3,
    "quadratic_drag": 0.2,
    "axial_stiffness": 6e5,
    "axial_damping": 30.0,
    "grasp_stiffness": 2.0,
    "grasp_damping": 5e-3,
}

# Files that take longest come first, so that parallel workers end together, also those
# of the last folders. Files that use the same compiled kernels follow one another, so
# that one worker compiles them.
LONGEST = (
    "drivers/test_filming",
    "drivers/test_run_interrupted",
    "drivers/test_serial_link",
    "pipeline/test_command_line",
    "checking/test_check",
    "diagnosis/test_forward_selection",
    "diagnosis/test_from_the_command_line",
    "diagnosis/test_hidden_causes",
    "extraction/test_extract",
    "report/test_pages_in_a_browser",
    "report/test_report",
    "report/test_diagnosis_page",
    "sweep/test_ledger",
    "sweep/test_sweep_command",
    "virtual_lab/test_bench",
    "faults/test_run_faults",
    "faults/test_full_disk",
    "benchmarks/test_drawing",
)


# Emulated arms, killed processes and sweeps need pseudo-terminals, fork and flock.
# Windows has none of these, as the front page says.
collect_ignore = ["drivers", "faults", "sweep"] if os.name == "nt" else []


def pytest_collection_modifyitems(items):
    order = [ROOT / f"tests/{name}.py" for name in LONGEST]
    items.sort(
        key=lambda item: order.index(item.path) if item.path in order else len(order)
    )


def pytest_configure(config):
    """Look for garbage less often: at Python's thresholds it takes 9 % of the time."""
    gc.set_threshold(100_000, 10, 10)


def pytest_collection_finish(session):
    """Look for no garbage in what was imported, as it stays to the end."""
    gc.freeze()


def executed(stats):
    """Return whether any test was run to its end.

    `stats` holds reports by outcome.
    """
    return any(
        stats.get(outcome)
        for outcome in ("passed", "failed", "error", "xfailed", "xpassed")
    )


def pytest_sessionfinish(session, exitstatus):
    """Fail a run in which every test was skipped, because it has shown nothing."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    worker = hasattr(session.config, "workerinput")
    asked = (
        exitstatus == 0
        and reporter
        and not worker
        and not session.config.option.collectonly
    )
    if asked and not executed(reporter.stats):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED


@pytest.fixture(autouse=True, scope="session")
def no_wait_for_disk():
    """Skip waiting for the disk. Power cuts are tested in tests/store."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Return the empty folder of a plugin that this person has named."""
    folder = tmp_path / "my_lab"
    folder.mkdir()
    monkeypatch.setenv(PLUGINS_VARIABLE, str(folder))
    return folder


@pytest.fixture
def effects_folder(plugin):
    """Return the folder for effects of a plugin that this person has named."""
    (plugin / "effects").mkdir()
    return plugin / "effects"


@pytest.fixture(autouse=True, scope="session")
def cores_are_shared():
    """Give each parallel worker its share of the cores.

    Workers with all cores each would wait for one another. Linear algebra has one
    thread, as in a command: two threads spin while they wait and take 4 of a diagnosis'
    24 s of processor time. A stage has one process, in which tests replace functions.
    """
    import numba
    from threadpoolctl import threadpool_limits

    from stringcast.stages.workers import use_workers

    numba.set_num_threads(share())
    with threadpool_limits(1, "blas"), use_workers(1):
        yield


@pytest.fixture(autouse=True, scope="session")
def files_of_settings_are_parsed_once():
    """Cache the parsed text of settings files.

    A command composes its settings from 30 files, and the tests' process runs hundreds
    of commands. OmegaConf's result for a text is kept, which saves a quarter of a
    composition's time. It is kept as bytes, which are read in a seventh of the time
    of a copy.
    """
    from omegaconf import OmegaConf

    parse = OmegaConf.load
    kept = cache(lambda text: pickle.dumps(parse(io.StringIO(text))))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            OmegaConf,
            "load",
            lambda file: (
                pickle.loads(kept(file.read()))
                if hasattr(file, "read")
                else parse(file)
            ),
        )
        yield


@pytest.fixture(autouse=True, scope="session")
def files_of_settings_are_merged_once():
    """Keep the files that Hydra chooses for the options of groups, and their sum.

    That is most of a composition, and other commands differ in single values alone.
    Files of plugins are chosen and merged each time.
    """
    from hydra._internal import config_loader_impl

    from stringcast.pipeline.settings.composition import conf_folders

    choose = config_loader_impl.create_defaults_list
    merge = config_loader_impl.ConfigLoaderImpl._compose_config_from_defaults_list
    chosen, merged = {}, {}

    def choose_files(repo, config_name, overrides_list, **how):
        if len(conf_folders()) > 1:
            return choose(repo, config_name, overrides_list, **how)
        options, values = [], []
        for override in overrides_list:
            is_option = repo.group_exists(override.key_or_group)
            (options if is_option else values).append(override)
        words = [override.input_line for override in options]
        sources = [source.full_path() for source in repo.get_sources()]
        key = (config_name, *words, *sources, *how.values())
        if key not in chosen:
            chosen[key] = choose(repo, config_name, options, **how)
        values = [value for value in values if not value.is_sweep_override()]
        values = [*chosen[key].config_overrides, *values]
        return replace(chosen[key], config_overrides=values)

    def merge_files(loader, defaults, repo):
        if all(defaults is not files.defaults for files in chosen.values()):
            return merge(loader, defaults, repo)
        if id(defaults) not in merged:
            merged[id(defaults)] = pickle.dumps(merge(loader, defaults, repo))
        return pickle.loads(merged[id(defaults)])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(config_loader_impl, "create_defaults_list", choose_files)
        patch.setattr(
            config_loader_impl.ConfigLoaderImpl,
            "_compose_config_from_defaults_list",
            merge_files,
        )
        yield


@pytest.fixture(autouse=True, scope="session")
def settings_are_composed_once():
    """Tell Hydra whether an experiment is a sweep.

    It composes all settings to learn that, and then again. An experiment of a plugin
    and a mode on the command line still decide by themselves.
    """
    from hydra._internal.hydra import Hydra

    learn_mode = Hydra.get_mode
    one_run = {
        file.stem
        for file in (ROOT / "conf" / "experiment").glob("*.yaml")
        if "MULTIRUN" not in file.read_text()
    }

    def get_mode(hydra, config_name, overrides):
        words = dict(word.partition("=")[::2] for word in overrides)
        experiment = words.get("+experiment")
        if "hydra.mode" not in words and experiment in {None, *one_run}:
            return None
        return learn_mode(hydra, config_name, overrides)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Hydra, "get_mode", get_mode)
        yield


def share():
    """Return the number of cores of each worker."""
    import numba

    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return max(numba.config.NUMBA_NUM_THREADS // workers, 1)


@pytest.fixture
def called(monkeypatch, capsys):
    """Run the command in this process, where the test does not need a separate one.

    A separate process takes 2 s to start.
    """

    def call(*words):
        capsys.readouterr()
        status = run_here(monkeypatch, *words)
        said = capsys.readouterr()
        return completed(status, said.out, said.err)

    return call


def call_command(*words):
    """Run the command in this process, as `called`, for fixtures of a whole file."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        status = run_here(patch, *words)
    return completed(status, out.getvalue(), err.getvalue())


def run_here(patch, *words):
    """Run the command in this process, and return its status or its last words."""
    from stringcast.pipeline import __main__ as shell
    from stringcast.pipeline.sweep.lazy_launcher import LazyLauncher

    patch.setattr(sys, "argv", ["pipeline", *map(str, words)])
    # as Hydra expects when the module is run
    patch.setattr(shell.main.__wrapped__, "__module__", "__main__")
    # set here so that monkeypatch restores it
    patch.setenv("HYDRA_FULL_ERROR", "0")
    # set here, too: a program that was called keeps its own until it ends
    patch.setattr(sys, "unraisablehook", sys.unraisablehook)
    # reset, because only a sweep sets it
    patch.setattr(LazyLauncher, "current", None)
    patch.chdir(ROOT)
    try:
        return shell.cli()
    except SystemExit as stopped:
        return stopped.code


def completed(status, out, err):
    """Return a command's status and what it printed, as of a process that ended."""
    # the text of an exit, which Python would print
    words = status if isinstance(status, str) else ""
    code = 1 if words else status or 0
    return subprocess.CompletedProcess(sys.argv, code, out, err + words)


@pytest.fixture
def undrawn(monkeypatch):
    """Leave pictures of pages empty except for their words.

    Drawing takes most of a page's time.
    """
    leave_pictures_empty(monkeypatch)


def leave_pictures_empty(patch):
    """Leave pictures empty, as `undrawn`, for fixtures of a whole file."""
    empty = SimpleNamespace(print_svg=lambda data, metadata: data.write("<svg></svg>"))
    patch.setattr(
        "stringcast.stages.report.theme.FigureCanvasSVG", lambda figure: empty
    )


@pytest.fixture
def undrawn_trial(monkeypatch):
    """Draw no first trial of an import."""
    place = "stringcast.pipeline.commands.import_.draw_first_trial"
    monkeypatch.setattr(place, lambda *given: None)


@contextmanager
def threads(number):
    """Run the block with a number of Numba's threads."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(number)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def other_threads():
    """Return another number of threads than now, where there are several cores."""
    import numba

    return threads(1 if numba.get_num_threads() > 1 else numba.config.NUMBA_NUM_THREADS)


@cache
def measured_sample():
    """Return the sample as `check` reads it, with arm and camera of the settings."""
    from stringcast.pipeline.commands.check import read_measurements

    return read_measurements(ROOT / "data" / "sample", [])


def configured(kind, path):
    """Return an object of the default settings in a file of `conf`."""
    block = yaml.safe_load((ROOT / "conf" / path).read_text())
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in block.items()})


@pytest.fixture(scope="session")
def arm() -> Arm:
    from stringcast.stages.model.arm import Arm

    return configured(Arm, "arm/paper.yaml")


@pytest.fixture(scope="session")
def camera() -> Camera:
    from stringcast.stages.model.camera import Camera

    return configured(Camera, "camera/highspeed.yaml")


@pytest.fixture(scope="session")
def null_dataset():
    """Draw trials that hide nothing, of the seed 1."""
    from tests.benchmarks.simulators import draw

    return draw("own_kernel", 1, "none")


@pytest.fixture(scope="session")
def sample_trial(tmp_path_factory):
    """Write a folder with one trial of the sample."""
    import pandas as pd

    folder = tmp_path_factory.mktemp("theirs")
    sample = ROOT / "data" / "sample"
    shutil.copy(sample / "dataset.yaml", folder)
    for file in ("arm.parquet", "points.parquet"):
        table = pd.read_parquet(sample / file)
        table[table["trial"] == "t00"].to_parquet(folder / file)
    return folder


def ordinary(arm) -> Model:
    """Return the configured base model of an ordinary string before a simple camera."""
    from stringcast.stages.model.camera import Camera
    from stringcast.stages.model.model import Model
    from stringcast.stages.model.string import String

    return Model(
        String(0.3), arm, Camera(640, 640, 340.0, (251.5, 387.5), 200.0, 0.001, 0.0)
    )


def implicit_string(points, largest_step, length=0.3, **settings) -> String:
    """Return a string with half cells at its ends and implicit time steps."""
    from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
    from stringcast.stages.model.string import String

    return String(
        length,
        points,
        tip_cell=0.5,
        grasp_cell=0.5,
        integrator=ImplicitLeapfrog(),
        largest_step=largest_step,
        **settings,
    )


def simulated_points(trial, values):
    """Return points (N, 2) of a string of these values at the measured ones [m]."""
    _, motion = next(trial.simulate(values[None]))
    return trial.sample_at_points(motion.points)[0]


def rms_distance(trial, values):
    """Return the rms distance of a string of these values from measured points [m]."""
    import numpy as np

    simulated = simulated_points(trial, values)
    return np.sqrt(trial.mean_square_distances(simulated)[0])


def specimen(name) -> Specimen:
    from stringcast.hardware.virtual.bench import Specimen

    return configured(Specimen, f"specimen/{name}.yaml")


def waving_pose(t: np.ndarray, size: float, angle: float) -> np.ndarray:
    """Return poses (K, 3) of a hand that waves by `size` [m] from an angle [rad]."""
    import numpy as np

    x, y, turn = np.sin(np.multiply.outer([9, 5, 7], t)) ** 2
    return np.stack([size * x, size * y, angle + 1.5 * turn], axis=-1)


def swing(duration=0.5, start=(-0.9, 0.6, 0.4), speeds=(7.0, 5.0, -8.0)) -> Motion:
    """Return a smooth movement of all joints as a Motion artifact."""
    import numpy as np
    import pandas as pd

    from stringcast.data.artifacts import JOINTS, SPEEDS, Motion

    t = np.arange(0, duration + 1e-9, 0.005)
    w = np.stack([a * np.sin(np.pi * t / duration) ** 2 for a in speeds], axis=-1)
    q = np.asarray(start) + np.concatenate(
        [np.zeros((1, 3)), np.cumsum(w[:-1], axis=0) * 0.005]
    )
    columns = (
        {"t": t}
        | dict(zip(JOINTS, q.T, strict=True))
        | dict(zip(SPEEDS, w.T, strict=True))
    )
    nothing = pd.DataFrame()
    return Motion(
        pd.DataFrame(columns),
        nothing,
        nothing,
        nothing,
        pd.DataFrame({"duration": [duration]}),
    )


@pytest.fixture(scope="session")
def filmed(arm, camera):
    """Perform and film a swing of a string; return the trial and the true string.

    The true string is given at the frames.
    """
    from stringcast.hardware.virtual.bench import (
        VirtualArm,
        VirtualBench,
        VirtualCamera,
    )
    from stringcast.stages.execute.execute import execute

    def film(name, fps=camera.fps, **how):
        bench = VirtualBench(arm, replace(camera, fps=fps), specimen(name), seed=3)
        trial = execute(
            swing(**how), VirtualArm(bench), VirtualCamera(bench), before=0.1, after=0.1
        )
        return trial, bench.string_at(trial.frames["t"].to_numpy())

    return film
