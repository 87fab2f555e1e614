"""Small runs: the real pipeline with toy stages, whose results depend on all inputs."""

import hashlib
import io
import time
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd

from stringcast.data import store
from stringcast.data.artifacts import Motion, Points, Trial
from stringcast.data.estimates import Estimate
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run import report
from stringcast.pipeline.run.file_names import LOG_FILE
from stringcast.pipeline.run.single_run import perform_run
from tests.experiments import compose_experiment

ROOT = Path(__file__).resolve().parents[2]
TINY = (
    "+experiment=quick",
    "camera.width=16",
    "camera.height=16",
    "camera.px_per_m=8",
    "camera.origin_px=[6,10]",
)
CALLS = []  # names of artifacts in the order in which they were made


class Killed(BaseException):
    """An exception like a kill: no code catches it."""


@contextmanager
def silent(name):
    """Report no progress."""
    yield lambda share: None


composed = cache(compose_experiment)


def toy_experiment(casts=2, pause=0.0, estimate_by=None, mode=None, **changed):
    """Return a toy experiment.

    pause: duration of each stage [s]. estimate_by: replaces the toy estimation. mode:
    replaces the casting. changed: blocks of settings.
    """
    whole = composed(*TINY, f"max_casts={casts}")
    stages = STAGES if estimate_by is None else STAGES | {"estimate": estimate_by}
    stages = {name: slow(stage, pause) for name, stage in stages.items()}
    return replace(
        whole,
        config={**whole.config, **changed},
        stages=stages,
        mode=mode or whole.mode,
    )


def slow(stage, pause):
    def called(*given, **how):
        time.sleep(pause)
        CALLS.append(stage.__name__)
        return stage(*given, **how)

    return called


def number(*given):
    """Return a number in 0..1 that depends on all arguments."""
    said = repr(
        [g.to_numpy().tolist() if isinstance(g, pd.DataFrame) else g for g in given]
    )
    return int.from_bytes(hashlib.sha256(said.encode()).digest()[:6], "big") / 2**48


def rows(table, count=2, **columns):
    """Return a table; columns that are not given are zero, false or empty."""
    zero = {"float": 0.0, "int": 0, "bool": False, "text": "", "bytes": b""}
    return pd.DataFrame(
        {c.name: columns.get(c.name, [zero[c.kind]] * count) for c in table.columns}
    )


def generate(model, target, obstacles, motion, estimate, *, seed, progress):
    x = number(
        None if estimate is None else estimate.values(),
        None if motion is None else motion.commands,
        seed,
    )
    tables = {name: rows(table) for name, table in Motion.TABLES.items()}
    return Motion(
        **tables
        | {"commands": rows(Motion.TABLES["commands"], t=[0.0, 0.1], q1=x, w1=x)}
    )


def execute(motion, arm, camera):
    x = number(motion.commands)
    tables = {name: rows(table) for name, table in Trial.TABLES.items()}
    tables["arm"] = rows(Trial.TABLES["arm"], t=[0.0, 0.1], q1=x)
    tables["frames"] = rows(
        Trial.TABLES["frames"], t=[0.0, 0.1], file=["images/0.png", "images/1.png"]
    )
    tables["link"] = rows(Trial.TABLES["link"], 1, valid=[True])
    return Trial(
        **tables,
        images=[np.full((16, 16), int(255 * x) ^ i, np.uint8) for i in range(2)],
    )


def extract(footage, camera, *, progress):
    x = float(np.mean([image.mean() for image in footage.images]))
    tables = {name: rows(table) for name, table in Points.TABLES.items()}
    tables["points"] = rows(
        Points.TABLES["points"], t=[0.0, 0.1], s=[0.1, 0.1], x=[x, x], valid=[True] * 2
    )
    tables["readings"] = rows(
        Points.TABLES["readings"], t=[0.0, 0.1], valid=[True] * 2, tip_x=[9 + x, 9 + x]
    )
    return Points(**tables)


def estimate(model, observations, last, *, seed, cast_number, progress):
    x = number(
        *(o.points for o in observations),
        None if last is None else last.values(),
        seed,
        cast_number,
    )
    tables = {name: rows(table) for name, table in Estimate.TABLES.items()}
    names = ["bending_stiffness", "axial_stiffness"]
    tables["parameters"] = rows(
        Estimate.TABLES["parameters"], name=names, value=[x, -x]
    )
    tables["fit"] = rows(Estimate.TABLES["fit"], 1, after=[x])
    return Estimate(
        **tables
        | {"candidates": tables["candidates"].assign(**dict.fromkeys(names, x))}
    )


def hardware(arm, camera, *, seed, trial):
    return SimpleNamespace(arm=nullcontext(), camera=nullcontext())


STAGES = {
    "generate": generate,
    "execute": execute,
    "extract": extract,
    "estimate": estimate,
    "hardware": hardware,
}


def toy_run(folder, here):
    """Perform a run with empty pictures; return the made artifacts and the output."""
    CALLS.clear()
    drawn = report.write_report
    report.write_report = lambda here, result: store.write_text(
        result.folder / "report.html", "<html>"
    )
    said = Terminal(file=io.StringIO(), width=1000)
    try:
        perform_run(here, folder, said)
    finally:
        report.write_report = drawn
    return [name for name in CALLS if name != "hardware"], said.file.getvalue()


def contents(folder):
    """Return content hashes of all files of a run, by path."""
    # the log holds times, which differ between runs
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != LOG_FILE)
    shown = [
        p
        for p in files
        if not any(part.startswith(".") for part in p.relative_to(folder).parts)
    ]
    return {p.relative_to(folder).as_posix(): store.content_hash(p) for p in shown}
