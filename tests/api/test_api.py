"""The Python interface gives the same answers as the command line."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import stringcast as sc
from stringcast.answers import DiagnosisResult
from stringcast.known import experiment_for_call

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "data" / "sample"
BENCH = {"links": [0.25, 0.20, 0.135], "base": [0.2, 0.2]}
HEAVY = ("numba", "cv2", "matplotlib", "pandas", "hydra", "pyarrow")


def test_emulated_arm_is_filmed_by_a_given_camera():
    words = ("hardware=emulator", "source.seconds=7.0")
    config = experiment_for_call(words, None).config
    assert config["hardware"]["source"] == config["source"]
    assert config["source"]["seconds"] == 7.0


def test_importing_the_package_loads_nothing():
    code = f"import stringcast, sys; print([m for m in {HEAVY} if m in sys.modules], len(dir(stringcast)))"
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert said.split() == ["[]", str(len(sc.__all__) + 1)]
    assert all(callable(getattr(sc, name)) for name in sc.__all__)
    with pytest.raises(
        AttributeError, match=r"no attribute 'diagnos'\. There are .*diagnose"
    ):
        _ = sc.diagnos


def test_trials_from_folder_and_tables_are_equal():
    read = sc.read(SAMPLE)
    assert len(read) == 5
    pd.testing.assert_frame_equal(sc.sample().table, read.table)
    points, arm = (
        pd.read_parquet(SAMPLE / f"{name}.parquet") for name in ("points", "arm")
    )
    made = sc.trials(points, arm=arm, length=0.304, sigma=0.0007, **BENCH)
    pd.testing.assert_frame_equal(made.table, read.table)
    assert "<table" in read._repr_html_()
    assert repr(read) == f"Trials(5 of {SAMPLE})"
    one = points[points["trial"] == "t00"].drop(columns="trial")
    its_arm = arm[arm["trial"] == "t00"].drop(columns="trial")
    assert list(sc.trials(one, arm=its_arm, length=0.304, **BENCH).table["trial"]) == [
        "t00"
    ]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: sc.read("nowhere"), "nowhere: there is no such folder. Name"),
        (lambda: sc.trials(pd.DataFrame(), length=0.3), "either grasp= .* or arm="),
        (
            lambda: sc.trials(
                pd.DataFrame(), arm=pd.DataFrame(), length=0.3, links=[0.2] * 3
            ),
            "Give links=.*base=",
        ),
        (
            lambda: sc.generate(target=(400, 700)),
            "out of reach.*target.x=.*Choose a closer target",
        ),
        (lambda: sc.generate(None, "generate.longst=1", target=(0.4, 0.7)), "longest"),
        (
            lambda: sc.generate(
                None, "source=video", "source.path=film.mp4", target=(0.4, 0.7)
            ),
            "virtual lab films",
        ),
        (lambda: sc.KnownString.load("nowhere"), "Name the run folder of a diagnosis"),
        (
            lambda: experiment_for_call((), sc.KnownString({"effects": ["tipmass"]})),
            "Did you mean 'tip_mass'",
        ),
    ],
)
def test_errors_name_the_remedy(call, says):
    with pytest.raises(sc.StringcastError, match=says):
        call()


@pytest.fixture(scope="module")
def motion():
    return sc.generate(
        None, "method=paper", "generate.longest=0.6", target=(0.45, 0.6), seed=1
    )


def test_simulated_string_agrees_with_the_plan(motion):
    """Commands sample the planned curve every 5 ms, so they differ by up to 0.1 mm."""
    planned = motion.string
    times = planned["t"].unique()
    string = sc.simulate(None, motion, "method=paper", times=times)
    pd.testing.assert_frame_equal(
        string[["t", "s", "x", "y"]],
        planned[["t", "s", "x", "y"]].reset_index(drop=True),
        atol=1e-4,
    )
    fine = sc.simulate(
        None, motion, "method=paper", times=np.arange(0, motion.duration, 1e-4)
    )
    tip = fine[fine["s"] == fine["s"].max()]
    inside = (np.abs(tip["x"] - 0.45) <= 0.01) & (np.abs(tip["y"] - 0.6) <= 0.02)
    assert inside.any()


def test_arguments_override_the_known_string(motion, tmp_path):
    known = sc.KnownString(
        {
            "effects": ["tip_mass"],
            "parameter_values": {"tip_mass.ratio": 0.2},
            "string": {"points": 12},
        }
    )
    again = sc.KnownString.load(known.save(tmp_path).parent)
    assert (again.effects, again.parameters) == (["tip_mass"], {"tip_mass.ratio": 0.2})
    plain, heavy = (
        sc.simulate(string, motion, "string.points=10") for string in (None, again)
    )
    # a setting of the call overrides the known string
    assert heavy["s"].nunique() == 10
    assert sc.simulate(again, motion)["s"].nunique() == 12
    assert np.hypot(heavy["x"] - plain["x"], heavy["y"] - plain["y"]).max() > 5e-3


def test_diagnosis_is_shown_from_its_tables(tmp_path):
    """The tables are synthetic; other tests cover the diagnosis itself."""
    from tests.report.test_diagnosis_page import make_diagnosis

    made = DiagnosisResult(
        make_diagnosis("effect", ["tip_mass"]), experiment_for_call((), None)
    )
    assert made.sentence in repr(made)
    assert made.verdict == made.document["verdict"]
    assert made.causes["effect"].iloc[0] in made._repr_html_()
    assert made.budget.empty
    budget = [
        {"source": "wind", "tip_rms_m": 2e-3, "log_evidence": 9.0},
        {"source": "noise", "tip_rms_m": 1e-3},
    ]
    misfit = {
        "tip_rms_m": {"value": 0.0, "low": 0.0, "high": 1e-3},
        "tolerance_m": 2e-3,
    }
    unexplained = made.document["unexplained"] | misfit
    made.artifact.finding["diagnosis"] = json.dumps(
        made.document | {"budget": budget, "unexplained": unexplained}
    )
    assert made.budget["source"].tolist() == ["wind", "noise"]
    assert made.budget["tip_rms_m"].tolist() == [2e-3, 1e-3]
    assert len(made.plot().axes[0].lines) == 3
    page = made.report(tmp_path / "page.html").read_text()
    assert page.startswith("<!DOCTYPE html>") or "<html" in page[:200]
    assert made.extended_model.settings


@pytest.mark.long
def test_sample_is_diagnosed_from_python(tmp_path):
    found = sc.diagnose(sc.read(SAMPLE))
    assert found.verdict == "effect"
    assert list(found.causes["effect"].unique()) == ["wind"]
    assert found.extended_model.effects == ["wind"]
