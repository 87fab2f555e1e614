"""Scores of a blind study, from rows made by hand, and rows made by a study in
miniature.
"""

import json
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from stringcast.data.dataset import read_dataset
from stringcast.pipeline.run.provenance import code_state
from stringcast.pipeline.settings.typed_settings import compose_settings
from stringcast.pipeline.studies.blind.pictures import pictures
from stringcast.pipeline.studies.blind.scores import TABLES, calibration_error, scores
from stringcast.pipeline.studies.blind.study import OneBench
from stringcast.pipeline.studies.blind.verdicts import (
    answered,
    beliefs,
    confidence,
    correct,
)
from stringcast.pipeline.studies.counts import counted
from stringcast.pipeline.studies.engine import all_made, kept
from tests.benchmarks.simulators.blind import LATEST, VERSIONS, draw


def row(
    kind,
    names,
    verdict,
    causes=(),
    groups=(),
    alternatives=(),
    size=10.0,
    paper=40.0,
    seed=0,
    **parameters,
):
    """causes: (name, probability). parameters: name=(true, low, high), dots written as
    two underscores.
    """
    stated = {n.replace("__", "."): p for n, p in parameters.items()}
    intervals = {
        n: {"value": (low + high) / 2, "low": low, "high": high}
        for n, (_, low, high) in stated.items()
    }
    of = lambda cause: {n: p for n, p in intervals.items() if n.startswith(f"{cause}.")}  # noqa: E731
    return {
        "seed": seed,
        "runtime": 1.0,
        "diagnosis": {
            "verdict": verdict,
            "causes": [
                {"effect": c, "probability": p, "parameters": of(c)} for c, p in causes
            ],
            "alternatives": [{"effect": c, "probability": p} for c, p in alternatives],
            "indistinguishable": [list(group) for group in groups],
        },
        "truth": {
            "kind": kind,
            "names": list(names),
            "paper": paper,
            "sizes": dict.fromkeys(names, size),
            "parameters": {n: true for n, (true, _, _) in stated.items()},
        },
    }


WIND, MASS = ("wind", 0.9), ("tip_mass", 0.8)
TAPER = ("density_taper", 0.3)
RIGHT = {
    "named": row("effect", ["wind"], "effect", [WIND]),
    "named first of two": row("effect", ["wind"], "effect", [WIND, MASS]),
    "after resolution, which is true anyway": row(
        "effect", ["wind"], "effect", [("resolution", 1.0), WIND]
    ),
    "in the group of look-alikes": row(
        "effect",
        ["tip_mass"],
        "ambiguous",
        [TAPER, MASS],
        groups=[["density_taper", "tip_mass"]],
    ),
    "nothing there, nothing said": row("none", [], "none"),
    "nothing there but too few points": row(
        "none", [], "effect", [("resolution", 0.9)]
    ),
    "too few points": row(
        "resolution", ["resolution"], "effect", [("resolution", 0.9)]
    ),
    "unknown": row("outside", ["gust"], "unknown"),
    "both of a pair": row("pair", ["wind", "tip_mass"], "effect", [MASS, WIND]),
    "both of a pair, one in a group": row(
        "pair",
        ["wind", "tip_mass"],
        "ambiguous",
        [TAPER, WIND],
        groups=[["density_taper", "tip_mass"]],
    ),
}
SEVERAL = {
    "all three named": row(
        "triple", ["wind", "tip_mass", "density_taper"], "effect", [WIND, MASS, TAPER]
    ),
    "two of three": row(
        "triple", ["wind", "tip_mass", "density_taper"], "effect", [WIND, MASS]
    ),
}
WRONG = {
    "another": row("effect", ["wind"], "effect", [MASS]),
    "second": row("effect", ["wind"], "effect", [MASS, WIND]),
    "in a group that is not first": row(
        "effect",
        ["wind"],
        "ambiguous",
        [MASS, WIND],
        groups=[["wind", "anisotropic_drag"]],
    ),
    "among the alternatives only": row("effect", ["wind"], "none", alternatives=[WIND]),
    "unknown": row("effect", ["wind"], "unknown"),
    "a false alarm": row("none", [], "effect", [WIND]),
    "unknown though nothing is there": row("none", [], "unknown"),
    "too few points where ten do": row(
        "none", [], "effect", [("resolution", 0.9)], paper=1.0
    ),
    "a library name for an outside cause": row("outside", ["gust"], "effect", [WIND]),
    "nothing for an outside cause": row("outside", ["gust"], "none"),
    "one of a pair": row("pair", ["wind", "tip_mass"], "effect", [WIND]),
    "a pair in one group": row(
        "pair", ["wind", "tip_mass"], "ambiguous", [WIND], groups=[["wind", "tip_mass"]]
    ),
    "unknown, and too few points, though nothing is there": row(
        "none", [], "unknown", [("resolution", 0.5)]
    ),
    "a failure": row("none", [], "failed"),
    "too little data": row("effect", ["wind"], "insufficient"),
}


@pytest.mark.parametrize("name", RIGHT)
def test_right_answers(name):
    assert correct(RIGHT[name])


def test_a_cause_named_beside_unknown_is_no_right_answer():
    assert not correct(row("outside", ["gust"], "unknown", [WIND]))


@pytest.mark.parametrize("name", WRONG)
def test_wrong_answers(name):
    assert not correct(WRONG[name])


def test_the_probability_of_an_answer():
    assert confidence(RIGHT["named"]) == 0.9
    assert confidence(RIGHT["after resolution, which is true anyway"]) == 0.9
    grouped = RIGHT["in the group of look-alikes"]
    assert answered(grouped) == "tip_mass"
    assert confidence(grouped) == 1.0  # 0.3 + 0.8, at most 1
    silent = row("none", [], "none", alternatives=[("wind", 0.1)])
    assert beliefs(silent) == {"wind": 0.1, "none": 0.9}
    assert confidence(silent) == 0.9
    assert confidence(RIGHT["nothing there but too few points"]) == 0.9
    assert np.isnan(confidence(WRONG["a failure"]))


def test_exact_intervals():
    """Clopper and Pearson: none of 60 is below 1 - 0.025^(1/60) = 5.96 %; Table of 95 %
    limits for 9 of 10.
    """
    none = counted(pd.Series([False] * 60))
    assert (none["share"], none["low"]) == (0, 0)
    assert none["high"] == pytest.approx(1 - 0.025 ** (1 / 60), rel=1e-6)
    most = counted(pd.Series([True] * 9 + [False]))
    assert (most["low"], most["high"]) == pytest.approx((0.5550, 0.9975), abs=1e-4)


def test_calibration_error_by_hand():
    """0.9 said four times and right three times is off by 0.15; 0.5 said twice and
    right once is not off.
    """
    p, right = np.array([0.9] * 4 + [0.5] * 2), np.array([1, 1, 1, 0, 1, 0])
    assert calibration_error(p, right) == pytest.approx(0.15 * 4 / 6)
    # too sure in one bin and not sure enough in another: the two do not make up for
    # each other
    p, right = np.array([0.9] * 4 + [0.5] * 4), np.array([1, 1, 1, 0, 1, 1, 1, 0])
    assert calibration_error(p, right) == pytest.approx((0.15 * 4 + 0.25 * 4) / 8)


def test_of_a_triple_all_are_to_be_named_and_another_name_for_a_cause_is_as_right():
    assert [correct(one) for one in SEVERAL.values()] == [True, False]
    rates = scores([*SEVERAL.values()])["rates"].set_index("name")
    assert rates.loc["triple found", ["right", "count"]].tolist() == [1, 2]
    smooth = row("effect", ["maxwell_slip"], "effect", [("dahl_friction", 0.9)])
    assert not correct(smooth)
    smooth["truth"]["alike"] = {"dahl_friction": "maxwell_slip"}
    assert correct(smooth)
    assert (answered(smooth), confidence(smooth)) == ("maxwell_slip", 0.9)


def test_tables_of_known_rows():
    tables = scores([*RIGHT.values(), *WRONG.values()])
    assert set(tables) == set(TABLES)
    rates = tables["rates"].set_index("name")
    assert rates.loc["single effect found", ["right", "count"]].tolist() == [5, 11]
    assert rates.loc["pair found", ["right", "count"]].tolist() == [2, 4]
    assert rates.loc["one of a pair found", "right"] == 4
    assert rates.loc["false alarm", ["right", "count"]].tolist() == [5, 7]
    assert rates.loc["outside called unknown", ["right", "count"]].tolist() == [1, 3]
    assert rates.loc["outside named above 0.5", "right"] == 1
    # pairs are not in it
    assert tables["confusion"]["count"].sum() == len(RIGHT) + len(WRONG) - 4
    assert tables["by_size"]["count"].sum() == 11 + 4 + 3  # whatever has a size
    assert (tables["benches"]["correct"].sum()) == len(RIGHT)


def test_coverage_counts_parameters_of_true_causes_only():
    hit = row(
        "effect",
        ["wind"],
        "effect",
        [WIND],
        wind__along_x=(1.0, 0.9, 1.2),
        wind__along_y=(0.0, 0.1, 0.2),
    )
    other = row("effect", ["wind"], "effect", [MASS], wind__along_x=(1.0, 0.9, 1.2))
    other["diagnosis"]["causes"][0]["parameters"] = {
        "tip_mass.ratio": {"value": 0.1, "low": 0.0, "high": 0.2}
    }
    coverage = (
        scores([hit, other])["rates"].set_index("name").loc["parameter in its interval"]
    )
    assert (coverage["right"], coverage["count"]) == (1, 2)
    above = row("effect", ["wind"], "effect", [WIND], wind__along_x=(1.3, 0.9, 1.2))
    coverage = (
        scores([hit, above])["rates"].set_index("name").loc["parameter in its interval"]
    )
    assert (coverage["right"], coverage["count"]) == (1, 3)


def test_what_half_of_the_trials_named_is_lost_unless_all_name_it_or_a_look_alike_of_it():
    """Of a bench that was not asked twice, and of one whose half names nothing, it is
    not counted.
    """
    alike = row(
        "", [], "ambiguous", [TAPER, MASS], groups=[["density_taper", "tip_mass"]]
    )["diagnosis"]
    named = row("effect", ["tip_mass"], "effect", [MASS])
    halves = [
        named["diagnosis"],
        alike,
        row("", [], "effect", [MASS, WIND])["diagnosis"],
        row("", [], "none")["diagnosis"],
    ]
    tables = scores([named, *({**named, "half": half} for half in halves)])
    assert list(tables["benches"]["half"]) == [
        "",
        "tip_mass",
        "density_taper|tip_mass",
        "tip_mass wind",
        "",
    ]
    assert list(tables["benches"]["lost"]) == [0, 0, 0, 1, 0]
    rates = tables["rates"].set_index("name")
    assert list(rates.loc["named with half, lost with all", ["right", "count"]]) == [
        1,
        3,
    ]


def test_pictures_are_drawn_even_of_one_row(tmp_path):
    for rows in (
        [RIGHT["nothing there, nothing said"]],
        [*RIGHT.values(), *WRONG.values()],
    ):
        paths = pictures(scores(rows), tmp_path)
        assert [path.name for path in paths] == ["confusion.png", "overview.png"]
        assert all(imread(path).std() > 0.02 for path in paths)  # not blank


class Bench:
    """A seed to be guessed."""

    def __init__(self, seed):
        self.seed = seed

    def write(self, folder):
        folder.mkdir(parents=True)
        (folder / "points").write_text("." * self.seed)

    def envelope(self, path):
        path.parent.mkdir(exist_ok=True)
        path.write_text(
            json.dumps(
                row(
                    "effect" if self.seed % 2 else "none",
                    ["wind"] * (self.seed % 2),
                    "",
                )["truth"]
            )
        )


def looked(folder, share):
    """Notes that it ran; refuses to run twice, and to be wrong."""
    (folder.parent / f"ran-{folder.name}").touch(exist_ok=False)
    seed = len((folder / "points").read_text())
    if seed == 4:
        raise RuntimeError("no")
    return row("", [], "effect" if seed % 2 else "none", [WIND] * (seed % 2))[
        "diagnosis"
    ]


def timeless(rows):
    return [{**one, "runtime": 0} for one in rows]


def one_bench(seed, folder, draw, diagnose):
    return kept(OneBench(seed, folder, draw, diagnose), folder)


def test_a_study_goes_on_where_it_stopped_whatever_the_number_of_processes(tmp_path):
    seeds = [3, 1, 2]
    alone = [one_bench(seed, tmp_path / "a", Bench, looked) for seed in seeds[:2]]
    made, failed = all_made(
        [OneBench(seed, tmp_path / "a", Bench, looked) for seed in seeds],
        tmp_path / "a",
        2,
    )
    rows = [made[f"{seed:05d}"] for seed in seeds]
    assert not failed
    assert rows[:2] == alone
    assert timeless(rows) == timeless(
        one_bench(seed, tmp_path / "b", Bench, looked) for seed in seeds
    )
    assert [one["truth"]["kind"] for one in rows] == ["effect", "effect", "none"]
    assert all(correct(one) for one in rows)
    assert {(one["version"], one["code"]) for one in rows} == {
        (LATEST, code_state()["commit"])
    }
    assert not list((tmp_path / "a" / "datasets" / "00001").glob("*.json"))


def test_a_study_that_is_replicated_asks_half_of_the_trials_as_well(tmp_path):
    asked = []

    def asks(folder, share):
        asked.append(share)
        return row("", [], "effect", [WIND if share == 1 else MASS])["diagnosis"]

    made = kept(OneBench(1, tmp_path, Bench, asks, replicated=True), tmp_path)
    assert asked == [1.0, 0.5]
    assert list(scores([made])["benches"]["lost"]) == [1]


def test_a_diagnosis_that_fails_is_a_wrong_answer(tmp_path):
    failed = one_bench(4, tmp_path, Bench, looked)
    assert failed["diagnosis"]["error"] == "RuntimeError: no"
    assert not correct(failed)


@pytest.mark.parametrize(
    ("laboratory", "points"), [("own", 10), ("nodal", 57), ("pyelastica", 57)]
)
def test_only_the_virtual_lab_is_asked_about_ten_points(laboratory, points):
    """A seed of its own may hide that they are too few; beside any other string they
    always are.
    """
    config = compose_settings(["+experiment=blind_study", f"laboratory={laboratory}"])
    assert (config["study"]["laboratory"], config["string"]["points"]) == (
        laboratory,
        points,
    )


def test_a_bench_of_the_lab_is_one(arm, camera, tmp_path):
    """The true envelope, opened by a diagnosis that finds nothing: right on a null
    bench.
    """
    made = one_bench(
        VERSIONS[LATEST].cases.index("none"),
        tmp_path,
        partial(draw, arm=arm, camera=camera),
        nothing,
    )
    assert made["truth"]["kind"] == "none"
    assert scores([made])["benches"]["correct"].all()


def nothing(folder, share):
    assert read_dataset(folder).trials
    return {"verdict": "none"}


KILLED = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from stringcast.pipeline.studies.engine import end_with_parent

def work(path):
    open(path, "w").write(str(os.getpid()))
    time.sleep(60)

if __name__ == "__main__":
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), end_with_parent) as pool:
        pool.submit(work, sys.argv[1] + ".part").result()
"""


def test_workers_end_when_the_study_is_killed(tmp_path):
    script, note = tmp_path / "study.py", tmp_path / "worker.part"
    script.write_text(KILLED)
    root = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    study_of_one = subprocess.Popen(
        [sys.executable, script, tmp_path / "worker"],
        env=root,
        stderr=subprocess.DEVNULL,
    )
    try:
        until(lambda: note.exists() and note.read_text())
    finally:
        study_of_one.kill()
    worker = int(note.read_text())
    until(
        lambda: (
            not Path(f"/proc/{worker}").exists()
            or "Z" in Path(f"/proc/{worker}/stat").read_text()
        )
    )


def until(come, seconds=120.0):
    end = time.monotonic() + seconds
    while not come():
        assert time.monotonic() < end
        time.sleep(0.05)
