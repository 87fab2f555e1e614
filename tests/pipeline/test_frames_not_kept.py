"""Runs without stored frames are reproducible datasets."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT

from stringcast.data import dataset
from stringcast.data.artifacts import Points, Trial
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.commands.index import list_runs
from stringcast.pipeline.commands.verify import verify_run
from tests.faults.toy import STAGES, rows, silent, toy_experiment, toy_run


@pytest.fixture
def run(tmp_path):
    """Make a toy run without stored frames."""
    folder = tmp_path / "outputs" / "run"
    toy_run(folder, toy_experiment(2, saved_outputs=["report"]))
    assert not list(folder.rglob("*.png"))
    return folder


def test_steps_stay_fresh_and_frames_are_reported_as_not_kept(run, capsys):
    output = {}
    for name, place in (
        ("why", run),
        ("lineage", run / "iterations/02/trial"),
        ("index", run.parent),
    ):
        assert load_command(name)([str(place)]) == 0
        output[name] = capsys.readouterr().out
    assert "stale" not in output["why"]
    assert "iterations/02/trial: fresh; its frames were not kept" in output["why"]
    assert "its frames were not kept" in output["lineage"]
    assert "HAS CHANGED" not in output["lineage"]
    assert "not kept" in output["index"]
    (row,) = list_runs(run.parent).itertuples()
    assert (row.stale, row.not_kept) == ("", "frames")


def test_continued_run_repeats_no_step(run):
    made, output = toy_run(run, toy_experiment(2, saved_outputs=["report"]))
    assert made == []
    assert "report.html stays as it is: the frames were not kept" in output


def test_verify_films_removed_frames_again(run, tmp_path):
    here = toy_experiment(2, saved_outputs=["report"])
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    outcome = verify_run(here, run, scratch, silent)
    assert outcome.is_same, outcome.lines
    place = outcome.lines.index("iterations/02/trial: the same to the bit")
    assert "its frames were not kept" in outcome.lines[place + 1]


def test_dataset_without_frames_keeps_all_rows(run):
    data = dataset.read_dataset(run)
    assert not data.films
    assert "frames.parquet" not in data.row_counts


def test_damaged_frame_is_filmed_again(tmp_path):
    folder = tmp_path / "run"
    toy_run(folder, toy_experiment(1))
    frame = folder / "iterations/01/trial/images/1.png"
    whole = frame.read_bytes()
    frame.write_bytes(whole[:-20])
    made, output = toy_run(folder, toy_experiment(1))
    assert made == ["execute"]
    assert "images/1.png is damaged" in output
    assert frame.read_bytes() == whole


def recorded_stages():
    """Return stages that replay a trial of the sample."""
    arm, points = (
        pd.read_parquet(ROOT / "data/sample" / f"{name}.parquet").query(
            "trial == 't00'"
        )
        for name in ("arm", "points")
    )
    times = np.unique(points["t"])
    files = [f"images/{number}.png" for number in range(len(times))]

    def perform(motion, arm_model, camera):
        trial = STAGES["execute"](motion, arm_model, camera)
        joints = arm[["t", "q1", "q2", "q3"]].to_dict("list")
        return replace(
            trial,
            arm=rows(Trial.TABLES["arm"], len(arm), **joints),
            frames=rows(Trial.TABLES["frames"], len(times), t=times, file=files),
            images=[trial.images[0]] * len(times),
        )

    def read(footage, camera, *, progress):
        found = STAGES["extract"](footage, camera, progress=progress)
        columns = points[["t", "s", "x", "y"]].assign(sigma=7e-4).to_dict("list")
        table = Points.TABLES["points"]
        seen = rows(table, len(points), **columns, valid=[True] * len(points))
        return replace(found, points=seen, masks=Points.TABLES["masks"].empty())

    return STAGES | {"execute": perform, "extract": read}


def test_stored_points_are_checked_and_estimated(called, tmp_path):
    folder = tmp_path / "run"
    here = toy_experiment(1, saved_outputs=["report"])
    string = {**here.config["string"], "length": 0.304}
    here = toy_experiment(1, saved_outputs=["report"], string=string)
    toy_run(folder, replace(here, stages=recorded_stages()))
    assert not list(folder.rglob("*.png"))

    checked = called("check", folder)
    assert checked.returncode == 0, checked.stdout
    assert "Usable: 1 trial" in checked.stdout
    assert "left out" not in checked.stdout

    words = (f"trials={folder}", "saved_outputs=[]", f"hydra.run.dir={tmp_path / 'e'}")
    small = ("estimate=quick", "estimate.candidates=32")
    estimated = called("+experiment=estimate", *small, *words)
    assert estimated.returncode == 0, estimated.stderr
    assert "Estimated from 1 trial" in estimated.stderr
