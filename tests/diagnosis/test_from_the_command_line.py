"""A diagnosis as a person asks for it, and the model that it leaves."""

import json

import pytest
import yaml
from conftest import pipeline

from stringcast.hardware.virtual.blind import draw


@pytest.fixture(scope="module")
def places(arm, camera, tmp_path_factory):
    """A bench whose clocks differ, its envelope, and the run that diagnosed it."""
    place = tmp_path_factory.mktemp("clocks")
    bench = draw(158, arm, camera, 1)  # of those that look like a lag, the one that took least time in the blind study
    bench.write(place / "data")
    bench.envelope(place / "envelope.json")
    asked = ("+experiment=diagnose", f"trials={place / 'data'}", "diagnose.design.motions=60")
    done = pipeline(*asked, f"hydra.run.dir={place / 'run'}")
    assert done.returncode == 0, done.stderr
    return place


def test_an_arm_is_not_moved_for_trials_of_which_nobody_says_where_they_were_made(places, called, tmp_path):
    done = called("+experiment=decide", f"trials={places / 'data'}", f"hydra.run.dir={tmp_path / 'run'}")
    assert done.returncode == 1
    assert "hardware=serial" in done.stderr
    assert "Traceback" not in done.stderr


def test_other_experiments_take_the_extended_model(places, called):
    extended = yaml.safe_load((places / "run" / "extended.yaml").read_text())
    assert set(extended["effects"]) <= {"arm_lag", "time_offset"}
    wanted = ("+experiment=estimate", f"trials={places / 'data'}", f"extended={places / 'run'}")
    done = called(*wanted, "estimate.candidates=20", f"hydra.run.dir={places / 'again'}")
    assert done.returncode == 0, done.stderr
    settings = json.loads((places / "again" / "config.json").read_text())
    assert settings["effects"] == extended["effects"]
    assert settings["string"]["points"] == extended["string"]["points"]
    assert settings["known"] == extended["known"]


def test_what_is_not_a_diagnosis_is_refused_by_name(places, called, tmp_path):
    wanted = ("+experiment=estimate", f"trials={places / 'data'}", f"extended={tmp_path}")
    done = called(*wanted, f"hydra.run.dir={tmp_path / 'run'}")
    assert done.returncode == 1
    assert "extended.yaml" in done.stderr
    assert "Traceback" not in done.stderr
