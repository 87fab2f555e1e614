"""Benches that hide something, diagnosed from what was measured; the envelope is opened after the verdict.

Of each kind one of those that took least time in the study of all.
"""

import json
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from stringcast.hardware.virtual.blind import draw
from stringcast.pipeline.study.command import diagnosed

TOLD = 1e-6  # by which probabilities may miss one


@pytest.fixture(scope="module")
def config():
    with initialize_config_dir(str(Path("conf").resolve()), version_base="1.3"):
        return OmegaConf.to_container(compose("config", ["+experiment=blind_study"]), resolve=True)


@pytest.fixture
def verdict(config, arm, camera, tmp_path):
    """Draw the bench of a seed, diagnose its folder, and only then read the envelope."""

    def of(seed):
        bench = draw(seed, arm, camera, 1)
        bench.write(tmp_path / "data")
        bench.envelope(tmp_path / "envelope.json")
        said = diagnosed(tmp_path / "data", config)
        return said, json.loads((tmp_path / "envelope.json").read_text())

    return of


def total(said):
    return sum(each["probability"] for each in (*said["causes"], *said["alternatives"]))


def test_what_is_hidden_is_found_with_its_size(verdict):
    said, truth = verdict(154)
    assert said["verdict"] == "effect"
    assert [cause["effect"] for cause in said["causes"]] == truth["names"] == ["nonlinear_bending"]
    found = said["causes"][0]["parameters"]["nonlinear_bending.hardening"]
    assert found["value"] == pytest.approx(truth["parameters"]["nonlinear_bending.hardening"], rel=0.1)
    assert total(said) == pytest.approx(1.0, abs=TOLD)
    assert said["next_experiment"] is None
    assert said["gain"]["rms_m"]["extended"] < 0.7 * said["gain"]["rms_m"]["base"]


def test_nothing_is_named_where_nothing_is_hidden(verdict):
    """All strings of the lab are finer than ten points of Eq. 1 can represent: that, and nothing else, may be said."""
    said, truth = verdict(3092)
    assert truth["kind"] == "none"
    assert {cause["effect"] for cause in said["causes"]} <= {"resolution"}
    assert said["verdict"] in ("none", "effect")


def test_what_is_not_in_the_library_is_called_unknown(verdict):
    said, truth = verdict(2888)
    assert truth["kind"] == "outside"
    assert said["verdict"] == "unknown"
    assert said["causes"] == []
    assert all(each["probability"] <= 0.5 for each in said["alternatives"] if each["effect"] != "unknown")
    assert said["unexplained"]["sentence"]
