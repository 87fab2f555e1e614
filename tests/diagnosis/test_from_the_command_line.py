"""A diagnosis by its command, and experiments with the extended model."""

import json

import pytest
import yaml
from conftest import call_command, leave_pictures_empty

from stringcast.data.artifacts import Motion
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.store import load
from stringcast.stages.clock import offset
from tests.diagnosis.slow_casts import write_slow_casts


@pytest.fixture(scope="module")
def folder(arm, camera, tmp_path_factory):
    """Diagnose two slow casts whose joints lag by 1 ms; return data/ and run/."""
    folder = tmp_path_factory.mktemp("lag")
    write_slow_casts(folder / "data", arm, camera, {"arm_lag.time_constant": 1e-3})
    trials_with_tested_clocks = []
    with pytest.MonkeyPatch.context() as patch:
        leave_pictures_empty(patch)
        # a fit of seconds, which tests/checking/test_clocks.py has
        patch.setattr(
            offset,
            "refuse_wrong_clock",
            lambda model, trials, rng: trials_with_tested_clocks.extend(trials),
        )
        command = call_command(
            "+experiment=diagnose",
            f"trials={folder / 'data'}",
            "diagnose.starts=2",
            "diagnose.design.motions=20",
            "diagnose.criteria.tip_tolerance_m=0.0005",  # the lag moves the tip 1 mm
            f"hydra.run.dir={folder / 'run'}",
        )
    assert command.returncode == 0, command.stderr
    assert "Warning" not in command.stderr
    assert len(trials_with_tested_clocks) == 2
    return folder


@pytest.fixture(scope="module")
def document(folder):
    return json.loads((folder / "run" / "diagnosis.json").read_text())


def test_a_lag_and_a_clock_offset_are_look_alikes(document):
    assert document["verdict"] == "ambiguous"
    groups = [set(group) for group in document["indistinguishable"]]
    assert groups == [{"arm_lag", "time_offset"}]
    rows = [*document["causes"], *document["alternatives"]]
    total = sum(row["probability"] for row in rows)
    assert total == pytest.approx(1.0, abs=1e-6)
    rms = document["gain"]["rms_m"]
    assert rms["extended"] < rms["base"]


def test_a_motion_that_distinguishes_them_is_proposed(folder, document):
    experiment = document["next_experiment"]
    assert set(experiment["between"]) == {"arm_lag", "time_offset"}
    repeated = experiment["already_performed"]["probability_to_decide"]
    assert experiment["probability_to_decide"] > repeated
    motion = load(Motion, folder / "run" / experiment["motion"])
    assert len(motion.commands) > 20
    page = (folder / "run" / "report.html").read_text().replace("&#39;", "'")
    assert experiment["sentence"] in page


def test_deciding_needs_an_arm_for_trials_of_unknown_origin(folder, called, tmp_path):
    command = called(
        "+experiment=decide",
        f"trials={folder / 'data'}",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert command.returncode == 1
    assert "hardware=serial" in command.stderr
    assert "Traceback" not in command.stderr


def test_a_diagnosis_leaves_evidence_and_a_page(folder):
    stored = next((folder / "run" / "iterations").glob("*/diagnosis"))
    diagnosis = load(Diagnosis, stored)
    assert diagnosis.verdict == "ambiguous"
    assert set(diagnosis.residuals["trial"]) == set(diagnosis.held_out["trial"])
    assert "arm_lag" in (folder / "run" / "report.html").read_text()


def test_other_experiments_use_the_extended_model(folder, called):
    extended = yaml.safe_load((folder / "run" / "extended.yaml").read_text())
    assert set(extended["effects"]) <= {"arm_lag", "time_offset"}
    command = called(
        "+experiment=estimate",
        f"trials={folder / 'data'}",
        f"model_from={folder / 'run'}",
        "estimate.candidates=20",
        f"hydra.run.dir={folder / 'estimate'}",
    )
    assert command.returncode == 0, command.stderr
    settings = json.loads((folder / "estimate" / "config.json").read_text())
    string = settings["string"]
    assert settings["effects"] == extended["effects"]
    assert string["points"] == extended["string"]["points"]
    assert string["length"] == pytest.approx(extended["string"]["length"])
    assert settings["parameter_values"] == extended["parameter_values"]


def test_a_folder_without_a_diagnosis_is_refused(folder, called, tmp_path):
    command = called(
        "+experiment=estimate",
        f"trials={folder / 'data'}",
        f"model_from={tmp_path}",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert command.returncode == 1
    assert "extended.yaml" in command.stderr
    assert "Traceback" not in command.stderr
