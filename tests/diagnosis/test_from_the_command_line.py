"""A diagnosis as a person asks for it, and the model that it leaves."""

import json

import pytest
import yaml
from conftest import pipeline

from stringcast.data.artifacts import Diagnosis, Motion
from stringcast.data.store import load
from tests.diagnosis.slow_casts import write_slow_casts


@pytest.fixture(scope="module")
def places(arm, camera, tmp_path_factory):
    """Two slow casts whose joints lag by 3 ms, and the run that diagnosed them."""
    place = tmp_path_factory.mktemp("lag")
    write_slow_casts(place / "data", arm, camera, {"arm_lag.time_constant": 3e-3})
    asked = (
        "+experiment=diagnose",
        f"trials={place / 'data'}",
        "diagnose.design.motions=60",
    )
    done = pipeline(*asked, f"hydra.run.dir={place / 'run'}")
    assert done.returncode == 0, done.stderr
    return place


def test_a_lag_and_an_offset_of_the_clock_are_not_told_apart(places):
    said = json.loads((places / "run" / "diagnosis.json").read_text())
    assert said["verdict"] == "ambiguous"
    assert [set(group) for group in said["indistinguishable"]] == [
        {"arm_lag", "time_offset"}
    ]
    whole = [each["probability"] for each in (*said["causes"], *said["alternatives"])]
    assert sum(whole) == pytest.approx(1.0, abs=1e-6)
    assert said["gain"]["rms_m"]["extended"] < said["gain"]["rms_m"]["base"]


def test_the_motion_that_tells_them_apart_is_proposed(places):
    said = json.loads((places / "run" / "diagnosis.json").read_text())[
        "next_experiment"
    ]
    assert set(said["between"]) == {"arm_lag", "time_offset"}
    assert (
        said["probability_to_decide"]
        > said["already_performed"]["probability_to_decide"]
    )
    assert len(load(Motion, places / "run" / said["motion"]).commands) > 20
    assert said["sentence"] in (places / "run" / "report.html").read_text().replace(
        "&#39;", "'"
    )


def test_an_arm_is_not_moved_for_trials_of_which_nobody_says_where_they_were_made(
    places, called, tmp_path
):
    done = called(
        "+experiment=decide",
        f"trials={places / 'data'}",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert done.returncode == 1
    assert "hardware=serial" in done.stderr
    assert "Traceback" not in done.stderr


def test_it_leaves_evidence_and_a_page(places):
    stored = next((places / "run" / "iterations").glob("*/diagnosis"))
    made = load(Diagnosis, stored)
    assert made.verdict == "ambiguous"
    assert set(made.residuals["trial"]) == set(made.held_out["trial"])
    assert "arm_lag" in (places / "run" / "report.html").read_text()


def test_other_experiments_take_the_extended_model(places, called):
    extended = yaml.safe_load((places / "run" / "extended.yaml").read_text())
    assert set(extended["effects"]) <= {"arm_lag", "time_offset"}
    wanted = (
        "+experiment=estimate",
        f"trials={places / 'data'}",
        f"model_from={places / 'run'}",
    )
    done = called(
        *wanted, "estimate.candidates=20", f"hydra.run.dir={places / 'again'}"
    )
    assert done.returncode == 0, done.stderr
    settings = json.loads((places / "again" / "config.json").read_text())
    assert settings["effects"] == extended["effects"]
    assert settings["string"]["points"] == extended["string"]["points"]
    assert settings["string"]["length"] == pytest.approx(extended["string"]["length"])
    assert settings["parameter_values"] == extended["parameter_values"]


def test_what_is_not_a_diagnosis_is_refused_by_name(places, called, tmp_path):
    wanted = (
        "+experiment=estimate",
        f"trials={places / 'data'}",
        f"model_from={tmp_path}",
    )
    done = called(*wanted, f"hydra.run.dir={tmp_path / 'run'}")
    assert done.returncode == 1
    assert "extended.yaml" in done.stderr
    assert "Traceback" not in done.stderr
