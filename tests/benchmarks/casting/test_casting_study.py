"""The casting study: what its executor measures, and what its tables count."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import specimen, swing
from omegaconf import OmegaConf

from stringcast.data.artifacts import JOINTS
from stringcast.data.diagnoses import Diagnosis
from stringcast.hardware.virtual.bench import VirtualArm, VirtualBench
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.model_settings import build_string
from stringcast.stages.hit_test import hit_test
from tests.benchmarks.casting.point_executor import PointExecutor, measure_points
from tests.benchmarks.casting.runs import (
    diagnosed_model,
    hidden_tip_shift,
    perform_training,
    run_settings,
)
from tests.benchmarks.casting.scores import FINDINGS, TABLES, score_casts
from tests.benchmarks.casting.study import CastingStudy
from tests.benchmarks.casting.worlds import World
from tests.benchmarks.study import study_settings


def test_points_are_those_of_the_bench_with_noise_of_the_size_told(arm, camera):
    bench = VirtualBench(arm, replace(camera), specimen("A"), seed=3)
    device, motion = VirtualArm(bench), swing()
    device.move_to(motion.commands[list(JOINTS)].iloc[0].tolist())
    device.perform(motion.commands)
    t = np.arange(0, 0.3, 0.005)
    seen = measure_points(bench, t, 0.0007, np.random.default_rng(0))
    true = bench.string_at(t)
    tips = seen.readings[["tip_x", "tip_y"]].to_numpy()
    assert np.std(tips - true[:, -1]) == pytest.approx(0.0007, rel=0.2)
    last = seen.points[seen.points["s"] == seen.points["s"].max()]
    np.testing.assert_array_equal(last[["x", "y"]].to_numpy(), tips)
    assert seen.points["s"].max() == pytest.approx(0.3)
    middle = seen.points.groupby("s").get_group(seen.points["s"].unique()[5])
    at = round(middle["s"].iloc[0] / 0.3 * (true.shape[1] - 1))
    assert np.abs(middle[["x", "y"]].to_numpy() - true[:, at]).max() < 5 * 0.0007


def cast_rows(case, method, seed, *hits, chance=np.nan):
    return [
        {
            "case": case,
            "method": method,
            "seed": seed,
            "cast": number,
            "hit": hit,
            "probability": chance,
        }
        | {
            "distance": 0.01,
            "planning": 1.0,
            "residual": 0.001,
            "prediction_error": 0.1 / number,
            "believed": hit,
            "effects": "",
            "code": "a",
        }
        for number, hit in enumerate(hits, start=1)
    ]


def test_runs_of_several_versions_of_the_code_are_named():
    rows = [*cast_rows("A", "ours", 0, True), *cast_rows("A", "ours", 1, True)]
    for codes, several in ((("a", "a"), False), (("a", "b"), True)):
        tables = score_casts(
            pd.DataFrame(
                [row | {"code": code} for row, code in zip(rows, codes, strict=True)]
            ),
            2,
        )
        assert ("2 versions of the code" in CastingStudy().summary(tables)) == several


def test_hits_are_counted_by_run():
    """Hits are counted for each run.

    Two cases share a seed, which does not make them one run. A run that never hits
    counts in every row.
    """
    rows = [
        *cast_rows("A", "ours", 0, True, chance=0.8),
        *cast_rows("B", "ours", 0, False, True, chance=0.8),
    ]
    rows += [
        *cast_rows("A", "paper", 0, False, False, False),
        *cast_rows("B", "paper", 0, False, True),
    ]
    tables = score_casts(pd.DataFrame(rows), 3)
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
    assert (predicted["right"], predicted["count"], predicted["predicted"]) == (
        2,
        3,
        pytest.approx(0.8),
    )
    assert "paper: 0 %, 50 %, 50 % of 2 runs" in CastingStudy().summary(tables)
    for name, table in tables.items():
        TABLES[name].check(table)


def test_first_casts_are_counted_by_how_near_they_come():
    """Later casts do not count, and a run without a motion is a miss."""
    near = cast_rows("A", "ours", 0, False, True)
    far = cast_rows("A", "ours", 1, False)
    none = {"case": "A", "method": "ours", "seed": 2, "cast": 1, "hit": False}
    near[0]["distance"], near[1]["distance"], far[0]["distance"] = 0.04, 0.0, 0.08
    tables = score_casts(pd.DataFrame([*near, *far, none]), 2)
    counted = tables["first_casts"].set_index(["case", "outcome"]).loc["A"]
    assert counted["right"].to_dict() == {
        "hit": 0,
        "within 50 mm": 1,
        "within 100 mm": 2,
    }
    assert set(counted["count"]) == {3}
    assert counted["miss"].to_numpy() == pytest.approx(0.06)


def test_right_and_false_names_and_surprises_are_counted():
    found = [
        # hidden, moved [m], p-value, verdict, causes
        ("wind", 0.05, 0.01, "cause", "wind=1.00"),
        ("wind", 0.05, 0.50, "cause", "tip_mass=0.95"),
        ("wind", 0.01, 0.50, "cause", "wind=0.93 clamp=0.07"),
        ("wind tip_mass", 0.05, 0.50, "partial", "clamp=0.99"),
        # it has no name in the library, so that only a false one is possible
        ("attraction", 0.05, 0.50, "cause", "wind=0.95"),
        # of which one is as right as the other
        ("maxwell_slip", 0.05, 0.50, "cause", "dahl_friction=0.95"),
        ("", 0.0, 0.02, "not asked", ""),
        ("", 0.0, 0.03, "not asked", ""),
    ]
    names = ("hidden", "hidden_shift", "p_value", "verdict", "causes")
    casts = []
    for number, values in enumerate(found):
        (row,) = cast_rows("A", "adaptive", number, False, chance=0.95)
        casts.append(row | dict(zip(names, values, strict=True)))
    robust = cast_rows("A", "robust", 0, True)
    findings = score_casts(pd.DataFrame(casts + robust), 2)["findings"]
    FINDINGS.check(findings)
    assert set(findings["method"]) == {"adaptive"}
    counts = findings.set_index("finding")[["right", "count"]].to_numpy().tolist()
    assert counts == [[2, 4], [2, 8], [1, 2], [6, 8]]


def test_each_case_is_cast_with_each_set_of_hidden_effects():
    config = study_settings("adaptive", ["casting.seeds=1"])
    jobs = CastingStudy().jobs(config, Path())
    study = config["casting"]
    expected = len(study["cases"]) * len(study["hidden"]) * len(study["methods"])
    assert len({job.name for job in jobs}) == len(jobs) == expected
    changes = {job.name: job.change for job in jobs}
    seen = changes["B-wind-robust-0000"]
    assert seen["specimen"]["hidden"] == {"wind": {"along_x": 1.1, "along_y": 0.0}}
    assert (
        seen["specimen"]["parameters"] == study["cases"]["B"]["specimen"]["parameters"]
    )
    assert "effects" not in seen
    told = changes["B-wind-informed-0000"]
    assert told["effects"] == ["wind"]
    assert told["parameter_values"] == {"wind.along_x": 1.1, "wind.along_y": 0.0}


def test_a_reference_simulator_hides_its_causes_in_each_case():
    config = study_settings("worlds")
    jobs = CastingStudy().jobs(config, Path())
    changes = {job.name: job for job in jobs}
    job = changes["B-joint_gain-robust-0000"]
    assert job.world == World("nodal", {"joint_gain": {"hand.gain": 0.04}})
    # the lab itself hides nothing, so that nothing is hidden twice
    assert not job.change["specimen"]["hidden"]


@pytest.mark.parametrize(
    ("simulator", "cause"),
    [
        ("own_kernel", {"rod.bending": 0.05}),
        # it compiles for 25 s
        pytest.param("nodal", {"rod.bead_mass": 0.4}, marks=pytest.mark.long),
    ],
)
def test_a_reference_simulator_moves_the_string_of_the_lab(
    arm, camera, simulator, cause
):
    """Without a cause it agrees with the lab, whose string is A; with one it differs."""
    lab = VirtualBench(arm, camera, specimen("A"), seed=3)
    device, motion = VirtualArm(lab), swing()
    device.move_to(motion.commands[list(JOINTS)].iloc[0].tolist())
    device.perform(motion.commands)
    t = np.arange(0, 0.5, 0.01)
    plain = World(simulator, {}).replace_string(lab)
    apart = np.linalg.norm(plain.string_at(t) - lab.string_at(t), axis=-1)
    assert apart.max() < 2e-3
    hidden = {"cause": cause, "roll": {"camera.roll": 0.1}}
    other = World(simulator, hidden).replace_string(lab)
    moved = np.linalg.norm(other.string_at(t) - plain.string_at(t), axis=-1)
    assert moved.max() > 5e-3
    seen = other.camera_view(other.string_at, t)
    rolled = np.linalg.norm(seen - other.string_at(t), axis=-1)
    assert rolled.min() > 5e-3


def test_a_seed_draws_one_string_from_the_ranges_for_all_targets():
    config = study_settings("forecast", ["casting.seeds=20"])
    strings = {}
    for job in CastingStudy().jobs(config, Path()):
        parameters = job.change["specimen"]["parameters"]
        assert strings.setdefault(job.seed, parameters) == parameters
    drawn = pd.DataFrame(strings.values())
    exponents = []
    for parameter in build_string(config["string"], "conf/string").parameters:
        values = drawn[parameter.name].to_numpy()
        assert values.min() >= parameter.low
        assert values.max() <= parameter.high
        exponents.append(parameter.chi(values))
    # of 160 uniform numbers, within four standard errors
    assert np.mean(exponents) == pytest.approx(0.5, abs=4 * 0.29 / np.sqrt(160))
    assert np.std(exponents) == pytest.approx(0.29, abs=0.05)


def test_a_hidden_effect_moves_the_tip_as_the_camera_sees_it(rolled_camera):
    perform_training(rolled_camera, 1)
    bench = rolled_camera.benches[1]
    t = np.arange(0, 0.4, 0.01)
    true, seen = bench.string_at(t), bench.camera_view(bench.string_at, t)
    rolled = np.sqrt(np.mean(np.sum((seen - true)[:, -1] ** 2, axis=1)))
    assert hidden_tip_shift(bench, 0.4) == pytest.approx(rolled)
    assert rolled > 0.01


def test_a_run_takes_its_settings_from_case_and_method():
    config = study_settings("casting")
    study = config["casting"]
    paper, ours = (
        run_settings(config, study["cases"]["D"], study["methods"][m], 7, 4)
        for m in ("paper", "robust")
    )
    assert (
        paper["hardware"]["specimen"]
        == study["cases"]["D"]["specimen"]
        == ours["hardware"]["specimen"]
    )
    assert (paper["seed"], paper["max_casts"], paper["target"]["x"]) == (7, 4, 0.5)
    assert paper["generate"]["_target_"] == "stages.generate.generate.generate"
    assert ours["generate"]["_target_"] == "stages.generate.robust.generate"
    assert paper["string"]["points"] == paper["string"]["reference_points"] == 25
    assert (ours["string"]["points"], ours["string"]["reference_points"]) == (20, 10)
    assert "ImplicitLeapfrog" in ours["string"]["integrator"]["_target_"]


def test_a_case_says_only_what_differs_and_another_stage_comes_whole():
    config = study_settings("gain")
    study = config["casting"]
    lagging = run_settings(
        config, study["cases"]["arm_lag"], study["methods"]["diagnosed"], 3, 2
    )
    assert lagging["hardware"]["specimen"]["hidden"] == {
        "arm_lag": {"time_constant": 0.015}
    }
    assert (
        lagging["hardware"]["specimen"]["parameters"]
        == config["specimen"]["parameters"]
    )
    assert config["specimen"]["hidden"] == {}
    practice = run_settings(
        config, {}, {"generate": study["training"]["generate"]}, 3, 2
    )
    assert practice["generate"] == compose_settings(["method=paper"])["generate"]


def test_ways_of_learning_differ_in_their_motions_alone():
    """All methods but the paper's share one string and one estimation."""
    config = study_settings("learning")
    study = config["casting"]
    ways = {
        name: run_settings(config, study["cases"]["B"], method, 7, 4)
        for name, method in study["methods"].items()
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
def rolled_camera():
    """Return an executor whose camera is rolled by more than the target's width."""
    config = OmegaConf.to_container(
        OmegaConf.create(compose_settings(["+experiment=quick"])), resolve=True
    )
    hidden = {"specimen": {"hidden": {"camera_rotation": {"angle": 0.1}}}}
    here = prepare_experiment(
        run_settings(config, hidden, {}, 0, 1), lambda block: f"conf/{block}"
    )
    return PointExecutor(here, noise=1e-6)


def test_what_really_became_of_a_cast_is_told_whatever_the_camera_says(rolled_camera):
    taught = perform_training(rolled_camera, 1)[0]
    duration = float(taught.artifacts["trial"].arm["t"].iloc[-1]) - 0.2
    seen = hit_test(
        taught.artifacts["points"], rolled_camera.experiment.target, (), duration
    )
    real = rolled_camera.true_outcome(1, duration)
    away = np.hypot(
        rolled_camera.experiment.target.x, rolled_camera.experiment.target.y
    )
    assert abs(seen.distance - real.distance) > 0.2 * 0.1 * away
    bench = rolled_camera.benches[1]
    t = np.linspace(0, duration, 2000)
    true = np.hypot(
        *(
            bench.string_at(t)[:, -1]
            - [rolled_camera.experiment.target.x, rolled_camera.experiment.target.y]
        ).T
    ).min()
    assert real.distance == pytest.approx(true, abs=1e-4)


def test_training_casts_are_first_casts_that_differ_and_are_the_same_again(
    rolled_camera,
):
    one, two = perform_training(rolled_camera, 2)
    assert not one.artifacts["trial"].arm.equals(two.artifacts["trial"].arm)
    again = perform_training(PointExecutor(rolled_camera.experiment, noise=1e-6), 1)[0]
    pd.testing.assert_frame_equal(again.observation.points, one.observation.points)


def test_a_diagnosis_of_the_training_casts_makes_the_model_that_casts(
    rolled_camera, monkeypatch
):
    """The diagnosed model of the training casts replaces the method's model.

    The diagnosis uses what the training casts showed. Its model is merged into the
    settings of the method.
    """
    said = {
        "effects": ["camera_rotation"],
        "parameter_values": {"camera_rotation.angle": 0.1},
        "string": {"points": 15},
    }
    asked = []

    def diagnose(model, observations, *rest, **settings):
        asked.append([o.trial for o in observations])
        finding = pd.DataFrame([{"extended": yaml.safe_dump(said)}])
        tables = {name: table.empty() for name, table in Diagnosis.TABLES.items()}
        return Diagnosis(**tables | {"finding": finding})

    monkeypatch.setattr("stringcast.stages.diagnose.diagnose.diagnose", diagnose)
    taught = perform_training(rolled_camera, 2)
    config = {
        **rolled_camera.experiment.config,
        "diagnose": {"_target_": "stages.diagnose.diagnose.diagnose"},
    }
    assert (
        diagnosed_model(
            prepare_experiment(config, lambda block: f"conf/{block}"), taught
        )
        == said
    )
    assert asked == [["t01", "t02"]]
