"""The loop of casts, surprise and explanation survives a kill, and can be verified."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pandas as pd
import pytest

from stringcast.data.artifacts import READINGS, Points
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import EXPLANATION_SUMMARY, EXPLANATIONS, Explanation
from stringcast.data.store import load
from stringcast.pipeline.commands.verify import verify_run
from stringcast.pipeline.modes import Cast
from stringcast.pipeline.modes.cast import cast_outcome, describe_lack
from stringcast.stages.hit_test import HitResult
from tests.faults.toy import (
    STAGES,
    Killed,
    contents,
    number,
    rows,
    silent,
    toy_experiment,
    toy_run,
)

LOOP = Cast(("generate", "execute", "extract", "surprise", "estimate", "explain"))
EARLIER = []  # explanation of the casts before, of each call


def explain(
    model,
    observations,
    estimate,
    previous,
    is_surprising,
    tolerance_m,
    *,
    seed,
    cast_number,
    progress,
):
    EARLIER.append(previous)
    x = number(*(o.points for o in observations), estimate.values(), seed)
    tables = {name: getattr(estimate, name) for name in Estimate.TABLES}
    tables["parameters"] = tables["parameters"].assign(value=[x, -x])
    row = {"verdict": "cause", "candidates": 1, "fitted": 1, "sentence": "So."}
    return Explanation(
        **tables,
        explanations=rows(EXPLANATIONS, 1, effects=["wind"], probability=[1.0]),
        finding=EXPLANATION_SUMMARY.check(pd.DataFrame([row])),
    )


def adaptive(**stages):
    here = toy_experiment(2, mode=LOOP)
    return replace(here, stages={**here.stages, "explain": explain, **stages})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adaptive") / "run"
    EARLIER.clear()
    toy_run(folder, adaptive())
    return folder


def test_a_cast_is_planned_with_the_explanation_of_earlier_casts(whole):
    first = load(Explanation, whole / "iterations/01/explanation")
    last = load(Estimate, whole / "iterations/02/estimate")
    assert EARLIER[0] is None
    assert EARLIER[1].values() == first.values()
    planned_with = []

    def generate(*given, **how):
        planned_with.append(given[-1])  # the estimate
        return STAGES["generate"](*given, **how)

    folder = whole.with_name("again")
    toy_run(folder, adaptive(generate=generate))
    assert planned_with[0] is None
    assert planned_with[1].values() == first.values() != last.values()


def test_a_run_killed_before_the_next_cast_resumes_identically(whole, tmp_path):
    def struck(*given, **how):
        if given[-1] is not None:  # the estimate
            raise Killed
        return STAGES["generate"](*given, **how)

    folder = tmp_path / "run"
    with pytest.raises(Killed):
        toy_run(folder, adaptive(generate=struck))
    assert (folder / "iterations/01/explanation").is_dir()
    assert not (folder / "iterations/02").exists()
    made, _ = toy_run(folder, adaptive())
    assert made == ["generate", "execute", "extract", "estimate"]
    assert contents(folder) == contents(whole)


def test_an_adaptive_run_is_verified_exactly(whole, tmp_path):
    outcome = verify_run(adaptive(), whole, tmp_path, silent)
    assert outcome.is_same, outcome.lines
    assert "iterations/02/explanation: the same to the bit" in outcome.lines
    assert "iterations/02/surprise: the same to the bit" in outcome.lines


def test_a_run_states_the_missing_causes_of_its_model(whole):
    sentence = json.loads((whole / "run.json").read_text())["sentence"]
    assert "The model lacked wind." in sentence
    named = load(Explanation, whole / "iterations/02/explanation")
    for verdict, words in {
        "candidates": "The model may lack wind (probability 1.00).",
        "partial": "The model may lack wind (probability 1.00).",
        "unknown": "",
        "not asked": "",
    }.items():
        finding = named.finding.assign(verdict=verdict)
        assert describe_lack(replace(named, finding=finding)) == words


def test_an_unreadable_trial_is_not_used(tmp_path):
    """The first cast is not read: the run continues with only the second."""
    read = []

    def extract(footage, camera, *, progress):
        read.append(footage)
        points = STAGES["extract"](footage, camera, progress=progress)
        if len(read) > 1:
            return points
        return replace(
            points,
            points=points.points.assign(valid=False),
            readings=points.readings.assign(valid=False),
        )

    folder = tmp_path / "run"
    made, printed = toy_run(folder, adaptive(extract=extract))
    assert made.count("generate") == 2
    assert made.count("estimate") == 1
    assert not (folder / "iterations/01/estimate").exists()
    assert (folder / "iterations/02/explanation").is_dir()
    assert "Cast 1: the trial is invalid: the string could not be read" in printed


def test_verify_notices_another_explanation(whole, tmp_path):
    def other(*given, **how):
        found = explain(*given, **how)
        return replace(found, parameters=found.parameters.assign(value=[0.5, 0.5]))

    outcome = verify_run(adaptive(explain=other), whole, tmp_path, silent)
    assert not outcome.is_same
    assert "iterations/02/explanation: DIFFERS" in outcome.lines


@pytest.mark.parametrize("entered", [True, False])
def test_a_tip_that_enters_the_box_without_a_hit_is_stated(entered):
    """It came within 8 mm of the centre, at 8 m/s instead of the required 14 m/s."""
    found = {Points: SimpleNamespace(readings=READINGS.empty())}
    verdict = HitResult(False, 0.25, 0.008, entered=entered)
    cast = SimpleNamespace(number=2, has_hit=False, verdict=verdict, find=found.get)
    sentence = cast_outcome([cast])
    assert sentence.startswith("The tip did not reach the target in 2 casts")
    assert ("wanted direction" in sentence) == entered
