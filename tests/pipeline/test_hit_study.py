"""The hit study: what its executor measures, and what its tables count."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import specimen, swing
from omegaconf import OmegaConf

from stringcast.data.artifacts import JOINTS
from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.typed_settings import compose_settings
from stringcast.pipeline.studies.hitting.executor import PointExecutor, measured
from stringcast.pipeline.studies.hitting.job import lessons, model_found, settings
from stringcast.pipeline.studies.hitting.scores import TABLES, scores
from stringcast.pipeline.studies.hitting.study import HitStudy
from stringcast.stages.hit_test import hit_test


def test_points_are_those_of_the_bench_with_noise_of_the_size_told(arm, camera):
    bench = VirtualBench(arm, replace(camera), specimen("A"), seed=3)
    device, motion = VirtualArm(bench), swing()
    device.move_to(motion.commands[list(JOINTS)].iloc[0].tolist())
    device.perform(motion.commands)
    t = np.arange(0, 0.3, 0.005)
    seen = measured(bench, t, 0.0007, np.random.default_rng(0))
    true = bench.string_at(t)
    tips = seen.readings[["tip_x", "tip_y"]].to_numpy()
    assert np.std(tips - true[:, -1]) == pytest.approx(0.0007, rel=0.2)
    last = seen.points[seen.points["s"] == seen.points["s"].max()]
    np.testing.assert_array_equal(last[["x", "y"]].to_numpy(), tips)
    assert seen.points["s"].max() == pytest.approx(0.3)
    middle = seen.points.groupby("s").get_group(seen.points["s"].unique()[5])
    at = round(middle["s"].iloc[0] / 0.3 * 39)
    assert np.abs(middle[["x", "y"]].to_numpy() - true[:, at]).max() < 5 * 0.0007


def made(case, method, seed, *hits, chance=np.nan):
    return [
        {
            "case": case,
            "method": method,
            "seed": seed,
            "cast": number,
            "hit": hit,
            "chance": chance,
        }
        | {
            "distance": 0.01,
            "planning": 1.0,
            "residual": 0.001,
            "foretelling": 0.1 / number,
        }
        for number, hit in enumerate(hits, start=1)
    ]


def test_states_of_the_code_are_told_apart():
    rows = [*made("A", "ours", 0, True), *made("A", "ours", 1, True)]
    for codes, pooled in (
        ((None, None), False),
        (("a", "a"), False),
        (("a", "b"), True),
        (("a", None), True),
    ):
        table = pd.DataFrame(
            [
                row | ({"code": code} if code else {})
                for row, code in zip(rows, codes, strict=True)
            ]
        )
        tables = scores(table, 2)
        assert list(tables["casts"]["code"]) == [code or "unknown" for code in codes]
        assert ("2 states of the code" in HitStudy().sentence(tables)) == pooled


def test_hits_are_counted_by_run():
    """Two cases share a seed, which does not make them one run; a run that never hits
    counts in every row.
    """
    rows = [
        *made("A", "ours", 0, True, chance=0.8),
        *made("B", "ours", 0, False, True, chance=0.8),
    ]
    rows += [
        *made("A", "paper", 0, False, False, False),
        *made("B", "paper", 0, False, True),
    ]
    tables = scores(pd.DataFrame(rows), 3)
    every = tables["rates"].set_index(["case", "method", "within"]).sort_index()
    assert every.loc[("all", "ours"), "right"].tolist() == [1, 2, 2]
    assert every.loc[("all", "paper"), "right"].tolist() == [0, 1, 1]
    assert every.loc[("A", "paper"), "count"].tolist() == [1, 1, 1]
    needed = tables["needed"].set_index(["case", "method"])["casts"]
    assert needed["all", "ours"] == 2
    assert np.isnan(needed["all", "paper"])
    learned = (
        tables["learned"].set_index(["case", "method", "after"])["median"].sort_index()
    )
    # a run that has hit stays as it is
    assert learned["all", "ours", 3] == pytest.approx((0.1 + 0.05) / 2)
    predicted = tables["calibration"].iloc[0]
    assert (predicted["right"], predicted["count"], predicted["foretold"]) == (
        2,
        3,
        pytest.approx(0.8),
    )
    assert "paper: 0 %, 50 %, 50 % of 2 runs" in HitStudy().sentence(tables)
    for name, table in tables.items():
        TABLES[name].check(table)


def test_a_run_takes_its_settings_from_case_and_method():
    config = compose_settings(["+experiment=hit_study"])
    hits = config["hits"]
    paper, ours = (
        settings(config, hits["cases"]["D"], hits["methods"][m], 7, 4)
        for m in ("paper", "robust")
    )
    assert (
        paper["hardware"]["specimen"]
        == hits["cases"]["D"]["specimen"]
        == ours["hardware"]["specimen"]
    )
    assert (paper["seed"], paper["manipulations"], paper["target"]["x"]) == (7, 4, 0.5)
    assert paper["generate"]["_target_"] == "stages.generate.generate.generate"
    assert ours["generate"]["_target_"] == "stages.generate.robust.generate"
    assert paper["string"]["points"] == paper["string"]["reference_points"] == 25
    assert (ours["string"]["points"], ours["string"]["reference_points"]) == (20, 10)
    assert "ImplicitLeapfrog" in ours["string"]["integrator"]["_target_"]


def test_a_case_says_only_what_differs_and_another_stage_comes_whole():
    config = compose_settings(["+experiment=gain_study"])
    hits = config["hits"]
    lagging = settings(
        config, hits["cases"]["arm_lag"], hits["methods"]["diagnosed"], 3, 2
    )
    assert lagging["hardware"]["specimen"]["hidden"] == {
        "arm_lag": {"time_constant": 0.015}
    }
    assert (
        lagging["hardware"]["specimen"]["parameters"]
        == config["specimen"]["parameters"]
    )
    assert config["specimen"]["hidden"] == {}
    practice = settings(config, {}, {"generate": hits["lessons"]["generate"]}, 3, 2)
    assert practice["generate"] == compose_settings(["method=paper"])["generate"]


def test_ways_of_learning_differ_in_their_motions_alone():
    """But for the paper's, all methods of the study have one string and one estimation."""
    config = compose_settings(["+experiment=learn_study"])
    hits = config["hits"]
    ways = {
        name: settings(config, hits["cases"]["B"], method, 7, 4)
        for name, method in hits["methods"].items()
    }
    own = ways.pop("paper")
    assert (
        len(
            {
                json.dumps(way | {"generate": None}, sort_keys=True)
                for way in ways.values()
            }
        )
        == 1
    )
    assert (
        len({json.dumps(way["generate"], sort_keys=True) for way in ways.values()})
        == len(ways)
        == 4
    )
    assert own["generate"] == ways["random"]["generate"]


@pytest.fixture
def turned():
    """An executor whose bench has a camera that is rolled by more than the target is
    wide.
    """
    config = OmegaConf.to_container(
        OmegaConf.create(compose_settings(["+experiment=quick"])), resolve=True
    )
    hidden = {"specimen": {"hidden": {"camera_rotation": {"angle": 0.1}}}}
    here = prepare_experiment(
        settings(config, hidden, {}, 0, 1), lambda block: f"conf/{block}"
    )
    return PointExecutor(here, noise=1e-6)


def test_what_really_became_of_a_cast_is_told_whatever_the_camera_says(turned):
    taught = lessons(turned, 1)[0]
    duration = float(taught.artifacts["trial"].arm["t"].iloc[-1]) - 0.2
    seen = hit_test(taught.artifacts["points"], turned.experiment.target, (), duration)
    real = turned.real(1, duration)
    away = np.hypot(turned.experiment.target.x, turned.experiment.target.y)
    assert abs(seen.distance - real.distance) > 0.2 * 0.1 * away
    bench = turned.benches[1]
    t = np.linspace(0, duration, 2000)
    true = np.hypot(
        *(
            bench.string_at(t)[:, -1]
            - [turned.experiment.target.x, turned.experiment.target.y]
        ).T
    ).min()
    assert real.distance == pytest.approx(true, abs=1e-4)


def test_lessons_are_first_casts_that_differ_and_are_the_same_again(turned):
    one, two = lessons(turned, 2)
    assert not one.artifacts["trial"].arm.equals(two.artifacts["trial"].arm)
    again = lessons(PointExecutor(turned.experiment, noise=1e-6), 1)[0]
    pd.testing.assert_frame_equal(again.observation.points, one.observation.points)


def test_a_diagnosis_of_the_lessons_makes_the_model_that_casts(turned, monkeypatch):
    """What is asked is what the lessons showed; what is said is laid over the settings
    of the method.
    """
    said = {
        "effects": ["camera_rotation"],
        "known": {"camera_rotation.angle": 0.1},
        "string": {"points": 15},
    }
    asked = []

    def diagnose(model, observations, *rest, **settings):
        asked.append([o.trial for o in observations])
        finding = pd.DataFrame([{"extended": yaml.safe_dump(said)}])
        return SimpleNamespace(finding=finding)

    monkeypatch.setattr("stringcast.stages.diagnose.diagnose.diagnose", diagnose)
    taught = lessons(turned, 2)
    config = {
        **turned.experiment.config,
        "diagnose": {"_target_": "stages.diagnose.diagnose.diagnose"},
    }
    assert (
        model_found(prepare_experiment(config, lambda block: f"conf/{block}"), taught)
        == said
    )
    assert asked == [["t01", "t02"]]
