"""Benches that hide something, diagnosed from what was measured; the envelope is opened
after the verdict.

Of each kind one of those that took least time in the study of all, and one that takes a
third of that: two slow casts, with a cause whose size nobody had to search for.
"""

import json
from functools import partial

import numpy as np
import pytest
import yaml
from conftest import ROOT

from stringcast.pipeline.settings.composition import compose_settings
from stringcast.stages.model.library import find_effects
from tests.benchmarks.diagnosis.study import diagnosis_document
from tests.benchmarks.simulators.blind import LATEST, VERSIONS, draw
from tests.benchmarks.simulators.blind.bench import BlindBench
from tests.benchmarks.simulators.blind.casts import random_cast
from tests.benchmarks.simulators.blind.scene import Scene

SIGMA = 7e-4  # [m]
TOLD = 1e-6  # by which probabilities may miss one


@pytest.fixture(scope="module")
def config():
    return compose_settings(["+experiment=diagnose", "string=paper"])


@pytest.fixture
def verdict(config, tmp_path):
    """Diagnose a bench's folder, and only then read the envelope."""

    def of(bench):
        bench.write(tmp_path / "data")
        bench.envelope(tmp_path / "envelope.json")
        said = diagnosis_document(tmp_path / "data", config)
        return said, json.loads((tmp_path / "envelope.json").read_text())

    return of


def slow(arm, camera):
    """Two slow casts of string B by joints that turn 2 % further than they report."""
    rng, base = (
        np.random.default_rng(41),
        yaml.safe_load((ROOT / "conf/specimen/B.yaml").read_text()),
    )
    casts = tuple(random_cast(arm, rng, camera.fps, (0.6, 1.5)) for _ in range(2))
    s = np.linspace(0.1, 1.0, 8) * base["length"]
    scene = Scene(
        arm,
        camera,
        base["length"],
        base["parameters"],
        casts,
        s,
        SIGMA,
        VERSIONS[LATEST],
    )
    hidden = {"joint_gain.gain": 0.02}
    clean, plain = scene.seen(
        scene.model(scene.fine, find_effects(["joint_gain"])), [hidden, {}]
    )
    sizes = {"joint_gain": scene.at_tip(clean - plain)}
    points = SIGMA * (clean + rng.standard_normal(clean.shape))
    return BlindBench(
        0, "effect", scene, (), hidden, sizes, np.nan, points, states_sigma=True
    )


def total(said):
    return sum(each["probability"] for each in (*said["causes"], *said["alternatives"]))


@pytest.mark.parametrize(
    "bench", [slow, pytest.param(partial(draw, 154, version=1), marks=pytest.mark.long)]
)
def test_what_is_hidden_is_found_with_its_size(verdict, arm, camera, bench):
    said, truth = verdict(bench(arm=arm, camera=camera))
    assert said["verdict"] == "effect"
    assert [cause["effect"] for cause in said["causes"]] == truth["names"]
    [(name, hidden)] = truth["parameters"].items()
    assert said["causes"][0]["parameters"][name]["value"] == pytest.approx(
        hidden, rel=0.1
    )
    assert total(said) == pytest.approx(1.0, abs=TOLD)
    assert said["next_experiment"] is None
    assert said["gain"]["rms_m"]["extended"] < 0.7 * said["gain"]["rms_m"]["base"]


def test_nothing_is_named_where_nothing_is_hidden(verdict, arm, camera):
    """All strings of the lab are finer than ten points of Eq. 1 can represent: that,
    and nothing else, may be said.
    """
    said, truth = verdict(draw(3092, arm, camera, 1))
    assert truth["kind"] == "none"
    assert {cause["effect"] for cause in said["causes"]} <= {"resolution"}
    assert said["verdict"] in ("none", "effect")


def test_what_is_not_in_the_library_is_called_unknown(verdict, arm, camera):
    said, truth = verdict(draw(2888, arm, camera, 1))
    assert truth["kind"] == "outside"
    assert said["verdict"] == "unknown"
    assert said["causes"] == []
    assert said["unexplained"]["sentence"]
