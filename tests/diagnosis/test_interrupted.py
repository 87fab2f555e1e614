"""A diagnosis that is interrupted ends with what it knows, and names nothing."""

import json

import pytest
import yaml

from stringcast.stages.common import Enough
from stringcast.stages.diagnose import diagnose as module
from tests.diagnosis.test_single_effects import casts, said_of


def interrupt(*given):
    raise Enough


def test_what_had_entered_is_said_and_nothing_is_named(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "settled", interrupt)
    made = said_of(*casts(arm, camera, ["tip_mass"], {"tip_mass.ratio": 0.05}), monkeypatch)
    said = json.loads(made.finding["diagnosis"].iloc[0])
    assert (said["verdict"], said["interrupted"], said["causes"]) == ("insufficient", True, [])
    assert "interrupted, when it had come to tip_mass (1.00)" in said["unexplained"]["sentence"]
    assert "cannot answer" not in made.sentence
    assert {each["effect"] for each in said["alternatives"] if each["probability"] > 0.5} == {"tip_mass"}
    assert yaml.safe_load(made.finding["extended"].iloc[0])["effects"] == []
    assert len(made.held_out) == 0
    assert made.theories["causes"].str.contains("tip_mass").any()


def test_before_there_is_a_base_model_nothing_is_known(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "prepared", interrupt)
    with pytest.raises(KeyboardInterrupt):
        said_of(*casts(arm, camera, [], {}), monkeypatch)
