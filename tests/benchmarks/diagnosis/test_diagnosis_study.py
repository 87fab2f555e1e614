"""Scores of a blind study.

Some are of rows made by hand, others of a small study.
"""

import json
import os
import re
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
from stringcast.data.store import read_table
from stringcast.pipeline.paper.scores import share_with_interval
from stringcast.pipeline.run.provenance import code_state
from stringcast.stages.diagnose.trials.outlying_trials import OUTLYING
from tests.benchmarks import draw as drawing
from tests.benchmarks.diagnosis.answers import (
    answer_name,
    answer_probability,
    cause_probabilities,
    is_correct,
)
from tests.benchmarks.diagnosis.pictures import draw_pictures
from tests.benchmarks.diagnosis.scores import (
    RECORDED,
    TABLES,
    calibration_error,
    score_rows,
)
from tests.benchmarks.diagnosis.study import DatasetJob
from tests.benchmarks.draw import draw_dataset
from tests.benchmarks.study import run_jobs, stored_result


def row(
    kind,
    names,
    verdict,
    causes=(),
    groups=(),
    alternatives=(),
    size=10.0,
    seed=0,
    **parameters,
):
    """Return a row of a diagnosis study.

    `causes` holds pairs (name, probability). `parameters` maps a name to (true, low,
    high); dots are written as two underscores.
    """
    stated = {n.replace("__", "."): p for n, p in parameters.items()}
    intervals = {
        n: {"value": (low + high) / 2, "low": low, "high": high}
        for n, (_, low, high) in stated.items()
    }
    of = lambda cause: {n: p for n, p in intervals.items() if n.startswith(f"{cause}.")}  # noqa: E731
    return {
        "seed": seed,
        "code": "a",
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
            "simulator": "own_kernel",
            "kind": kind,
            "names": list(names),
            "sizes": dict.fromkeys(names, size),
            "parameters": {n: true for n, (true, _, _) in stated.items()},
        },
    }


WIND, MASS = ("wind", 0.9), ("tip_mass", 0.8)
TAPER = ("density_taper", 0.3)
RIGHT = {
    "named": row("effect", ["wind"], "effect", [WIND]),
    "named first of two": row("effect", ["wind"], "effect", [WIND, MASS]),
    "in the group of look-alikes": row(
        "effect",
        ["tip_mass"],
        "ambiguous",
        [TAPER, MASS],
        groups=[["density_taper", "tip_mass"]],
    ),
    "nothing there, nothing said": row("none", [], "none"),
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
MIXED = {
    "known cause and remainder": row("mixed", ["wind", "gust"], "partial", [WIND]),
    "no remainder": row("mixed", ["wind", "gust"], "effect", [WIND]),
    "nothing named": row("mixed", ["wind", "gust"], "unknown"),
    "a false cause beside": row("mixed", ["wind", "gust"], "partial", [WIND, MASS]),
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
    "a library name for an outside cause": row("outside", ["gust"], "effect", [WIND]),
    "nothing for an outside cause": row("outside", ["gust"], "none"),
    "one of a pair": row("pair", ["wind", "tip_mass"], "effect", [WIND]),
    "a pair in one group": row(
        "pair", ["wind", "tip_mass"], "ambiguous", [WIND], groups=[["wind", "tip_mass"]]
    ),
    "a failure": row("none", [], "failed"),
    "too little data": row("effect", ["wind"], "insufficient"),
}


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_answer_is_counted_as_correct(name):
    assert is_correct(RIGHT[name])


def test_a_cause_named_beside_unknown_is_no_right_answer():
    assert not is_correct(row("outside", ["gust"], "unknown", [WIND]))


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_answer_is_not_counted_as_correct(name):
    assert not is_correct(WRONG[name])


def test_the_probability_of_an_answer_is_that_of_its_causes():
    assert answer_probability(RIGHT["named"]) == 0.9
    grouped = RIGHT["in the group of look-alikes"]
    assert answer_name(grouped) == "tip_mass"
    assert answer_probability(grouped) == 1.0  # 0.3 + 0.8, at most 1
    silent = row("none", [], "none", alternatives=[("wind", 0.1)])
    assert cause_probabilities(silent) == {"wind": 0.1, "none": 0.9}
    assert answer_probability(silent) == 0.9
    assert np.isnan(answer_probability(WRONG["a failure"]))


def test_shares_have_the_intervals_of_clopper_and_pearson():
    """Exact intervals are those of Clopper and Pearson.

    None of 60 is below 1 - 0.025^(1/60) = 5.96 %. The 95 % limits for 9 of 10 are from
    their table.
    """
    none = share_with_interval(pd.Series([False] * 60))
    assert (none["share"], none["low"]) == (0, 0)
    assert none["high"] == pytest.approx(1 - 0.025 ** (1 / 60), rel=1e-6)
    most = share_with_interval(pd.Series([True] * 9 + [False]))
    assert (most["low"], most["high"]) == pytest.approx((0.5550, 0.9975), abs=1e-4)


def test_calibration_error_by_hand():
    """The calibration error is the one computed by hand.

    A stated 0.9 that is right three times of four is off by 0.15. A stated 0.5 that is
    right once in two is not off.
    """
    p, right = np.array([0.9] * 4 + [0.5] * 2), np.array([1, 1, 1, 0, 1, 0])
    assert calibration_error(p, right) == pytest.approx(0.15 * 4 / 6)
    # overconfidence in one bin does not cancel underconfidence in another
    p, right = np.array([0.9] * 4 + [0.5] * 4), np.array([1, 1, 1, 0, 1, 1, 1, 0])
    assert calibration_error(p, right) == pytest.approx((0.15 * 4 + 0.25 * 4) / 8)


def test_of_a_triple_all_are_to_be_named_and_another_name_for_a_cause_is_as_right():
    assert [is_correct(one) for one in SEVERAL.values()] == [True, False]
    rates = score_rows([*SEVERAL.values()])["rates"].set_index("name")
    assert rates.loc["triple found", ["right", "count"]].tolist() == [1, 2]
    smooth = row("effect", ["maxwell_slip"], "effect", [("dahl_friction", 0.9)])
    assert not is_correct(smooth)
    smooth["truth"]["alike"] = {"dahl_friction": "maxwell_slip"}
    assert is_correct(smooth)
    assert (answer_name(smooth), answer_probability(smooth)) == ("maxwell_slip", 0.9)


def test_of_a_mixture_the_known_cause_is_named_and_a_remainder_reported():
    assert [is_correct(one) for one in MIXED.values()] == [True, False, False, False]
    rates = score_rows([*MIXED.values()])["rates"].set_index("name")
    assert rates.loc["mixed: known cause named", "right"] == 3
    assert rates.loc["mixed: false cause named", "right"] == 1
    assert rates.loc["mixed: remainder reported", "right"] == 3


def test_a_trial_that_is_excluded_as_unlike_the_others_reports_a_remainder():
    silent = row("outside", ["gust"], "none")
    assert not is_correct(silent)
    silent["diagnosis"]["trials"] = {"rejected": {"t3": f"{OUTLYING} to 90 mm"}}
    assert is_correct(silent)


def test_a_small_clock_error_of_a_mixture_may_be_named():
    named = row("mixed", ["wind", "gust"], "partial", [WIND, ("time_offset", 0.9)])
    assert not is_correct(named)
    named["truth"]["tolerated"] = ["time_offset"]
    assert is_correct(named)


def test_a_coarse_mesh_is_no_cause():
    """Only a wrong cause makes an answer wrong, not that ten points are too few."""
    coarse = ("resolution", 1.0)
    assert is_correct(row("none", [], "effect", [coarse]))
    assert not is_correct(row("none", [], "effect", [coarse, WIND]))
    outlying = row("outside", ["gust"], "effect", [coarse])
    assert not is_correct(outlying)  # nothing says that the gust is there
    outlying["diagnosis"]["trials"] = {"rejected": {"t01": f"{OUTLYING} more"}}
    assert is_correct(outlying)


def test_tables_count_answers_of_each_kind():
    tables = score_rows([*RIGHT.values(), *WRONG.values()])
    assert set(tables) == set(TABLES)
    rates = tables["rates"].set_index("name")
    assert rates.loc["single cause found", ["right", "count"]].tolist() == [3, 9]
    assert rates.loc["pair found", ["right", "count"]].tolist() == [2, 4]
    assert rates.loc["one of a pair found", "right"] == 4
    assert rates.loc["false alarm", ["right", "count"]].tolist() == [3, 4]
    assert rates.loc["outside called unknown", ["right", "count"]].tolist() == [1, 3]
    assert rates.loc["outside named above 0.5", "right"] == 1
    # the confusion matrix excludes pairs
    assert tables["confusion"]["count"].sum() == len(RIGHT) + len(WRONG) - 4
    # every dataset whose causes have a size
    assert tables["by_size"]["count"].sum() == 9 + 4 + 3
    assert (tables["diagnoses"]["correct"].sum()) == len(RIGHT)


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
        score_rows([hit, other])["rates"]
        .set_index("name")
        .loc["true value in its interval"]
    )
    assert (coverage["right"], coverage["count"]) == (1, 2)
    above = row("effect", ["wind"], "effect", [WIND], wind__along_x=(1.3, 0.9, 1.2))
    coverage = (
        score_rows([hit, above])["rates"]
        .set_index("name")
        .loc["true value in its interval"]
    )
    assert (coverage["right"], coverage["count"]) == (1, 3)


def test_pictures_are_drawn_even_of_one_row(tmp_path):
    for rows in (
        [RIGHT["nothing there, nothing said"]],
        [*RIGHT.values(), *WRONG.values()],
    ):
        paths = draw_pictures(score_rows(rows), tmp_path)
        assert [path.name for path in paths] == ["confusion.png", "overview.png"]
        # the picture is not blank
        assert all(imread(path).std() > 0.02 for path in paths)


def draw_guess(seed, folder, truth_file):
    """Draw a seed that a job guesses."""
    folder.mkdir(parents=True)
    (folder / "points").write_text("." * seed)
    hidden = ["wind"] * (seed % 2)
    truth_file.write_text(
        json.dumps(row("effect" if hidden else "none", hidden, "")["truth"])
    )


def looked(folder):
    """Record that the job ran, and raise if it runs twice or guesses wrongly."""
    (folder.parent / f"ran-{folder.name}").touch(exist_ok=False)
    seed = len((folder / "points").read_text())
    if seed == 4:
        raise RuntimeError("no")
    return row("", [], "effect" if seed % 2 else "none", [WIND] * (seed % 2))[
        "diagnosis"
    ]


def timeless(rows):
    return [{**one, "runtime": 0} for one in rows]


def draw_and_diagnose(seed, folder, draw, diagnose):
    return stored_result(DatasetJob(seed, folder, draw, diagnose), folder)


def test_a_study_goes_on_where_it_stopped_whatever_the_number_of_processes(tmp_path):
    seeds = [3, 1, 2]
    alone = [
        draw_and_diagnose(seed, tmp_path / "a", draw_guess, looked)
        for seed in seeds[:2]
    ]
    made, failed = run_jobs(
        [DatasetJob(seed, tmp_path / "a", draw_guess, looked) for seed in seeds],
        tmp_path / "a",
        2,
    )
    rows = [made[f"{seed:05d}"] for seed in seeds]
    assert not failed
    assert rows[:2] == alone
    assert timeless(rows) == timeless(
        draw_and_diagnose(seed, tmp_path / "b", draw_guess, looked) for seed in seeds
    )
    assert [one["truth"]["kind"] for one in rows] == ["effect", "effect", "none"]
    assert all(is_correct(one) for one in rows)
    assert {one["code"] for one in rows} == {code_state()["commit"]}
    assert not list((tmp_path / "a" / "datasets" / "00001").glob("*.json"))


def test_a_diagnosis_that_fails_is_a_wrong_answer(tmp_path):
    failed = draw_and_diagnose(4, tmp_path, draw_guess, looked)
    assert failed["diagnosis"]["error"] == "RuntimeError: no"
    assert not is_correct(failed)


def test_a_synthetic_dataset_that_hides_nothing(null_dataset, tmp_path, monkeypatch):
    """A diagnosis that finds nothing agrees with a ground truth without causes."""
    drawn = {("own_kernel", 1, "none"): null_dataset}
    monkeypatch.setattr(drawing, "draw", lambda *given, trials: drawn[given])
    made = draw_and_diagnose(
        1,
        tmp_path,
        partial(draw_dataset, "own_kernel", kind="none"),
        nothing,
    )
    assert made["truth"]["kind"] == "none"
    assert score_rows([made])["diagnoses"]["correct"].all()


def nothing(folder):
    assert read_dataset(folder).trials
    return {"verdict": "none"}


KILLED = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from tests.benchmarks.study import end_with_parent

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
    path = os.pathsep.join(
        [str(Path(__file__).resolve().parents[3]), os.environ.get("PYTHONPATH", "")]
    )
    command = [sys.executable, script, tmp_path / "worker"]
    study_of_one = subprocess.Popen(
        command, env={**os.environ, "PYTHONPATH": path}, stderr=subprocess.DEVNULL
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


ROOM = Path(__file__).parent


def test_the_page_says_what_the_recorded_table_says():
    recorded = read_table(RECORDED, ROOM / "results" / "diagnoses.parquet")
    page = (ROOM / "README.md").read_text(encoding="utf-8").splitlines()
    names = {"own kernel, finer mesh": "own_kernel", "nodal finite elements": "nodal"}
    names |= {
        "PyElastica (Cosserat rod)": "pyelastica",
        "all": "own_kernel|nodal|pyelastica",
    }
    for name, simulators in names.items():
        rows = recorded[recorded["simulator"].isin(simulators.split("|"))]
        inside = [
            value["inside"] for values in rows["values"] for value in json.loads(values)
        ]
        right = {
            kind: rows.loc[rows["kind"].isin(kinds.split()), "correct"]
            for kind, kinds in KINDS.items()
        }
        counts = [(one.sum(), len(one)) for one in right.values()] + [
            (sum(inside), len(inside))
        ]
        counts[2] = counts[2][1] - counts[2][0], counts[2][1]  # false alarms
        (line,) = [line for line in page if line.startswith(f"| {name} |")]
        assert [f"{k} of {n}" for k, n in counts] == re.findall(r"\d+ of \d+", line)


KINDS = {
    "single": "effect resolution",
    "several": "pair triple",
    "clean": "none",
    "unknown": "outside",
}
