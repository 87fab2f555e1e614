"""A sweep from the command line, with the real pipeline on a small measured trial.

Jobs write no page, as it would take most of their time. For speed, they are forked
unless another launcher runs them.
"""

import importlib.util
import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from conftest import call_command, leave_pictures_empty

from stringcast.data import store
from stringcast.pipeline.sweep.attempt import Attempt
from tests.faults import forked

PACKAGES = {"joblib": "joblib", "ray": "ray", "slurm": "submitit"}
HERE = {"joblib": "workers=2", "ray": "address=null", "slurm": "cluster=local"}


def sweep(folder, trials, threads, *overrides, betas="0.9,0.99"):
    asked = [
        "+experiment=estimate",
        f"trials={trials}",
        "estimate.candidates=32",
        f"estimate.beta={betas}",
        "saved_outputs=[]",
    ]
    how = [f"hydra.sweep.dir={folder}", f"hydra.launcher.threads={threads}"]
    return call_command("--multirun", *asked, *how, *overrides)


@pytest.fixture(scope="module")
def trials(tmp_path_factory, arm):
    """Write a foreign trial: a rigid string swings below an arm at rest."""
    folder = tmp_path_factory.mktemp("trials")
    t, s = np.arange(0, 0.3, 0.01), np.linspace(0.03, 0.3, 10)
    q = np.tile([1.5, 0.4, 0.8], (len(t), 1))
    pd.DataFrame(
        {"trial": "t00", "t": t, "q1": q[:, 0], "q2": q[:, 1], "q3": q[:, 2]}
    ).to_parquet(folder / "arm.parquet")
    hand, angle = arm.joint_positions(q)[:, -1], 0.3 * np.cos(6 * t)
    at = (
        hand[:, None]
        + s[None, :, None] * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)[:, None]
    )
    points = {"trial": "t00", "t": np.repeat(t, len(s)), "s": np.tile(s, len(t))}
    points |= {"x": at[..., 0].ravel(), "y": at[..., 1].ravel()}
    pd.DataFrame(points).to_parquet(folder / "points.parquet")
    about = {"format": 1, "name": "stick", "string": {"length": 0.3}}
    about["arm"] = {"links": list(arm.links), "base": list(arm.base)}
    (folder / "dataset.yaml").write_text(yaml.safe_dump(about))
    return folder


@pytest.fixture(scope="module")
def forked_jobs():
    """Run jobs of sweeps as forked processes with empty pictures."""
    with pytest.MonkeyPatch.context() as patch:
        leave_pictures_empty(patch)
        patch.setattr(Attempt, "_run_process", forked.process)
        yield


@pytest.fixture(scope="module")
def swept(forked_jobs, trials, tmp_path_factory):
    """Run a sweep of two jobs on one thread, the first of which is refused.

    Returns its folder and the result of the command.
    """
    folder = tmp_path_factory.mktemp("sweep")
    return folder, sweep(folder, trials, 1, betas="1.5,0.9")


def numbers(folder):
    """Return the contents of all steps of each job, by key."""
    return {
        place.parent.name: store.content_hash(place)
        for place in folder.glob("*/iterations")
    }


def attempts(folder):
    entries = [
        json.loads(file.read_text()) for file in (folder / "ledger").glob("*.json")
    ]
    return {
        entry["settings"]["estimate"]["beta"]: (entry["state"], entry["attempts"])
        for entry in entries
    }


def test_failed_job_is_kept_and_stops_no_other(swept):
    folder, said = swept
    assert said.returncode == 1
    assert "1 job(s) of the sweep failed" in said.stderr
    assert "Traceback" not in said.stderr
    assert attempts(folder) == {0.9: ("done", 1), 1.5: ("failed", 1)}
    table = pd.read_parquet(folder / "sweep.parquet").set_index("estimate.beta")
    assert "estimate.beta = 1.5" in table.loc[1.5, "error"]
    assert table["E_after"].notna().to_dict() == {0.9: True, 1.5: False}
    assert table["hit"].isna().all()  # no job has cast
    page = (folder / "report.html").read_text()
    assert "1 of 2 jobs are done" in page
    assert "estimate.beta = 1.5" in page


def test_sweep_table_agrees_with_runs_and_has_units(swept):
    folder, _ = swept
    table = pd.read_parquet(folder / "sweep.parquet").set_index("estimate.beta")
    made = pd.read_parquet(
        folder / table.loc[0.9, "folder"] / "iterations/01/estimate/parameters.parquet"
    )
    for row in made.itertuples():
        assert table.loc[0.9, row.name] == row.value
    for column in pq.read_schema(folder / "sweep.parquet"):
        assert {b"unit", b"meaning"} <= (column.metadata or {}).keys(), column.name
    assert store.read_origin(folder / "sweep.parquet")["code"]


def test_repeated_command_runs_missing_jobs_and_failed_ones_on_request(swept, trials):
    folder, _ = swept
    before = numbers(folder)
    table = folder / "sweep.parquet"
    table.write_bytes(
        table.read_bytes()[:100] + b"damaged" + table.read_bytes()[107:-30]
    )
    grown = sweep(
        folder,
        trials,
        1,
        "hydra.launcher.retry=true",
        betas="0.90,1.5",
    )
    assert grown.returncode == 1
    assert attempts(folder) == {0.9: ("done", 1), 1.5: ("failed", 2)}
    assert numbers(folder) == before
    assert len(pd.read_parquet(table)) == 2  # the table is written again


@pytest.mark.long
@pytest.mark.parametrize("launcher", PACKAGES)
def test_results_do_not_depend_on_the_launcher(launcher, swept, trials, tmp_path):
    """These jobs have two threads each, the reference has one."""
    if importlib.util.find_spec(PACKAGES[launcher]) is None:
        pytest.skip(f"needs {PACKAGES[launcher]}")
    alone, _ = swept
    said = sweep(
        tmp_path,
        trials,
        2,
        f"hydra/launcher={launcher}",
        f"hydra.launcher.{HERE[launcher]}",
    )
    assert said.returncode == 0, said.stderr
    assert len(numbers(tmp_path)) == 2
    assert numbers(alone).items() <= numbers(tmp_path).items()
