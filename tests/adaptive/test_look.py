"""A slow trial before the first cast, whose estimate is used to plan it."""

import json
from dataclasses import replace

import pandas as pd
import pytest

from stringcast.data.artifacts import CONTROL_POINTS
from stringcast.data.estimates import Estimate
from stringcast.data.store import load
from stringcast.pipeline.commands.verify import verify_run
from tests.faults.toy import STAGES, Killed, contents, silent, toy_experiment, toy_run

TRIAL = ["execute", "extract", "estimate"]
PLANNED_WITH = []  # earlier motion and estimate of each plan


def excite(model, obstacles, *, seed, progress):
    task = (model, None, obstacles, None, None)
    motion = STAGES["generate"](*task, seed=seed, progress=progress)
    return replace(motion, control_points=CONTROL_POINTS.empty())


def generate(*given, **how):
    _, _, _, motion, estimate = given
    PLANNED_WITH.append((motion, estimate))
    return STAGES["generate"](*given, **how)


def looking(casts=2, **stages):
    here = toy_experiment(casts, look="excite")
    known = {"excite": excite, "generate": generate}
    return replace(here, stages={**here.stages, **known, **stages})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("look") / "run"
    PLANNED_WITH.clear()
    toy_run(folder, looking())
    return folder


def test_the_first_cast_is_planned_with_the_estimate_of_the_look(whole):
    first, second = PLANNED_WITH
    look = load(Estimate, whole / "iterations/00/estimate")
    assert first[1].values() == look.values()
    assert first[0] is None  # a cast does not resemble a slow swing
    assert second[0] is not None
    assert (
        second[1].values() == load(Estimate, whole / "iterations/01/estimate").values()
    )


def test_a_look_is_a_trial_of_the_run_but_not_a_cast(whole):
    assert list(pd.read_parquet(whole / "arm.parquet")["trial"].unique()) == [
        "look",
        "t01",
        "t02",
    ]
    summary = json.loads((whole / "run.json").read_text())
    assert [cast["number"] for cast in summary["iterations"]] == [1, 2]
    assert "hit" not in summary["look"]
    assert "in 2 casts" in summary["sentence"]


def test_a_run_killed_after_its_look_does_not_look_again(whole, tmp_path):
    def struck(*given, **how):
        raise Killed

    folder = tmp_path / "run"
    with pytest.raises(Killed):
        toy_run(folder, looking(generate=struck))
    assert (folder / "iterations/00/estimate").is_dir()
    assert not (folder / "iterations/01").exists()
    made, _ = toy_run(folder, looking())
    assert made == TRIAL * 2
    assert contents(folder) == contents(whole)


def test_a_run_with_a_look_is_verified_exactly(whole, tmp_path):
    outcome = verify_run(looking(), whole, tmp_path, silent)
    assert outcome.is_same, outcome.lines
    assert "iterations/00/motion: the same to the bit" in outcome.lines


def test_an_unreadable_look_is_not_used(tmp_path):
    """The first cast is then planned as without a look."""
    read = []

    def extract(footage, camera, *, progress):
        read.append(footage)
        points = STAGES["extract"](footage, camera, progress=progress)
        if len(read) > 1:
            return points
        return replace(points, readings=points.readings.assign(valid=False))

    PLANNED_WITH.clear()
    _, printed = toy_run(tmp_path / "run", looking(1, extract=extract))
    assert PLANNED_WITH == [(None, None)]
    assert "Look at the string: the trial is invalid" in printed
