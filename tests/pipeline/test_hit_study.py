"""The hit study: what its desk measures, and what its tables count."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import specimen, swing

from data.artifacts import JOINTS
from hardware.virtual.bench import Bench, VirtualArm
from pipeline.hitting.desk import measured
from pipeline.hitting.job import settings
from pipeline.hitting.scores import TABLES, scores, sentence
from pipeline.settings import composed


def test_points_are_those_of_the_bench_with_noise_of_the_size_told(arm, camera):
    bench = Bench(arm, replace(camera), specimen("A"), seed=3)
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
        {"case": case, "method": method, "seed": seed, "cast": number, "hit": hit, "chance": chance}
        | {"distance": 0.01, "planning": 1.0, "residual": 0.001, "foretelling": 0.1 / number}
        for number, hit in enumerate(hits, start=1)
    ]


def test_hits_are_counted_by_run():
    """Two cases share a seed, which does not make them one run; a run that never hits counts in every row."""
    rows = [*made("A", "ours", 0, True, chance=0.8), *made("B", "ours", 0, False, True, chance=0.8)]
    rows += [*made("A", "paper", 0, False, False, False), *made("B", "paper", 0, False, True)]
    tables = scores(pd.DataFrame(rows), 3)
    every = tables["rates"].set_index(["case", "method", "within"]).sort_index()
    assert every.loc[("all", "ours"), "right"].tolist() == [1, 2, 2]
    assert every.loc[("all", "paper"), "right"].tolist() == [0, 1, 1]
    assert every.loc[("A", "paper"), "count"].tolist() == [1, 1, 1]
    needed = tables["needed"].set_index(["case", "method"])["casts"]
    assert needed["all", "ours"] == 2
    assert np.isnan(needed["all", "paper"])
    learned = tables["learned"].set_index(["case", "method", "after"])["median"].sort_index()
    assert learned["all", "ours", 3] == pytest.approx((0.1 + 0.05) / 2)  # a run that has hit stays as it is
    foretold = tables["calibration"].iloc[0]
    assert (foretold["right"], foretold["count"], foretold["foretold"]) == (2, 3, pytest.approx(0.8))
    assert "paper: 0 %, 50 %, 50 % of 2 runs" in sentence(tables)
    for name, table in tables.items():
        TABLES[name].check(table)


def test_a_run_takes_its_settings_from_case_and_method():
    config = composed(["+experiment=hit_study"])
    hits = config["hits"]
    paper, ours = (settings(config, hits["cases"]["D"], hits["methods"][m], 7, 4) for m in ("paper", "robust"))
    assert paper["hardware"]["specimen"] == hits["cases"]["D"]["specimen"] == ours["hardware"]["specimen"]
    assert (paper["seed"], paper["manipulations"], paper["target"]["x"]) == (7, 4, 0.5)
    assert paper["generate"]["_target_"] == "stages.generate.generate"
    assert ours["generate"]["_target_"] == "stages.generate.robust.generate"
    assert paper["string"]["points"] == paper["string"]["reference_points"] == 25
    assert (ours["string"]["points"], ours["string"]["reference_points"]) == (20, 10)
    assert "ImplicitLeapfrog" in ours["string"]["integrator"]["_target_"]
