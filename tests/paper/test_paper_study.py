"""The study of the paper's experiments on runs made up by hand.

It tests what counts as a hit, and when; that the study grows and continues; and that
tables, figures and page are made from the runs.
"""

import json
import re
import sys

import numpy as np
import pandas as pd
import pytest

from stringcast.data import store
from stringcast.data.artifacts import ARM, Motion, Points
from stringcast.data.estimates import Estimate
from stringcast.pipeline.paper import figure_data, scores
from stringcast.pipeline.paper.finish import TABLES, finish
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.ledger import DONE_STATE, FAILED_STATE, Job, Ledger
from stringcast.stages.report.pages.paper import paper_figures
from stringcast.stages.report.records import PaperRecord

INF = np.inf


def runs(**hits):
    """Return table RUNS.

    For each experiment it holds the casts in which its runs hit, in the order
    of their seeds.
    """
    rows = [
        {
            "condition": condition,
            "seed": seed,
            "state": "done",
            "error": "",
            "hit_at": hit_at,
            "budget": 5,
        }
        | {
            "casts": min(hit_at, 5),
            "seconds": 1.0,
            "folder": f"{condition}{seed}",
        }
        for condition, each in hits.items()
        for seed, hit_at in enumerate(each)
    ]
    return scores.RUNS.check(pd.DataFrame(rows))


def test_hit_rates_and_their_intervals_are_those_of_the_books():
    """Hit rates have Clopper and Pearson's intervals of 1, 3 and 4 of 4."""
    table = scores.rate_table(runs(wall=[1, 2, 2, 5])).set_index("within")
    assert table["right"].to_dict() == {1: 1, 2: 3, 3: 3, 4: 3, 5: 4}
    assert (table["count"] == 4).all()
    assert table.loc[1, ["share", "low", "high"]].tolist() == pytest.approx(
        [0.25, 0.0063, 0.8059], abs=1e-4
    )
    assert table.loc[3, ["share", "low", "high"]].tolist() == pytest.approx(
        [0.75, 0.1941, 0.9937], abs=1e-4
    )
    assert table.loc[5, ["share", "low", "high"]].tolist() == pytest.approx(
        [1.0, 0.3976, 1.0], abs=1e-4
    )


def test_experiments_are_counted_apart():
    table = scores.rate_table(runs(wall=[1, INF], D_500_500=[2])).set_index(
        ["condition", "within"]
    )
    assert table.loc[("wall", 5), ["right", "count"]].tolist() == [1, 2]
    assert table.loc[("D_500_500", 1), ["right", "count"]].tolist() == [0, 1]


def test_the_nine_are_counted_together_and_nothing_else_with_them():
    table = scores.rate_table(
        scores.add_pooled_experiment(
            runs(
                A_300_900=[1, 3],
                C_500_900=[2],
                A_900_500=[1],
                one_motion_A=[1],
                wall=[1],
            )
        )
    )
    together = table[table["condition"] == "nine"].set_index("within")
    assert together["right"].tolist() == [1, 2, 3, 3, 3]
    assert (together["count"] == 3).all()


def test_the_median_bears_runs_that_never_hit():
    """The median tolerates runs that never hit.

    Of six values the least and the largest hold the median with 1 - 2 / 64 = 97 %, of
    five with 94 %: no interval.
    """
    six = scores.median_with_interval(np.array([INF, 1, 2, 2, 3, INF]))
    assert (six["median"], six["low"], six["high"]) == (2, 1, INF)
    assert scores.median_with_interval(np.array([INF, INF, 1]))["median"] == INF
    assert np.isnan(scores.median_with_interval(np.array([1.0, 2, 3, 4, 5]))["low"])


def test_needed_stands_beside_the_paper():
    table = scores.needed_cast_table(runs(wall=[4, 5, 5], D_500_500=[2])).set_index(
        "condition"
    )
    assert table.loc["wall", ["median", "paper"]].tolist() == [5, 5]
    assert np.isnan(table.loc["D_500_500", "paper"])


def test_the_run_that_is_drawn_is_no_lucky_one():
    chosen = figure_data.choose_typical_runs(
        runs(wall=[1, INF, 3, 5, 3], D_500_500=[INF, 2, INF])
    ).set_index("condition")["seed"]
    assert chosen.to_dict() == {"wall": 2, "D_500_500": 0}


# --- a study end to end
T = np.arange(0, 0.31, 0.005)
S = np.linspace(0, 0.3, 10)


def strings(lift):
    """Return a straight string that hangs, and rises with time."""
    t, s = (a.ravel() for a in np.meshgrid(T, S, indexing="ij"))
    return pd.DataFrame({"t": t, "s": s, "x": 0.5 + 0 * s, "y": 0.8 - s + lift * t})


def leave_run(place, hits):
    """Write the files of a run whose casts hit or not."""
    config = compose_settings(
        ["+experiment=paper", "obstacles=wall", "target=at_900_500"]
    )
    place.mkdir(parents=True)
    (place / "config.json").write_text(json.dumps(config))
    casts = [
        {"number": n, "hit": hit, "miss_m": 0.05 / n, "t_closest": 0.2, "touched": 0}
        for n, hit in enumerate(hits, 1)
    ]
    rates = {"E_before": 0.5, "E_after": None}
    (place / "run.json").write_text(
        json.dumps(
            {
                "hit": any(hits),
                "sentence": "It has ended.",
                "iterations": [cast | rates for cast in casts],
            }
        )
    )
    for cast in casts:
        leave_cast(place / "iterations" / f"{cast['number']:02d}")


def leave_cast(place):
    nothing = {name: table.empty() for name, table in Motion.TABLES.items()}
    outcome = {column.name: [0.25] for column in Motion.TABLES["outcome"].columns}
    outcome |= {"limit": [""], "prospects": [""]}
    motion = Motion(
        **nothing | {"string": strings(1.0), "outcome": pd.DataFrame(outcome)}
    )
    store.save(motion, place / "motion", {})
    seen = {name: table.empty() for name, table in Points.TABLES.items()}
    store.save(Points(**seen | {"points": strings(0.9)}), place / "points", {})
    arm = pd.DataFrame({"t": T, "q1": T, "q2": 0.5 + T, "q3": 0.1})
    store.write_table(ARM, arm, place / "trial" / "arm.parquet", {})
    rates = pd.DataFrame({"trial": "t", "t": T, "before": 0.4, "after": 0.8})
    store.write_table(
        Estimate.TABLES["matching"], rates, place / "estimate" / "matching.parquet", {}
    )


STAND_IN = """
import pathlib, re, shutil, sys
given = dict(a.lstrip("+").split("=", 1) for a in sys.argv[1:])
place = pathlib.Path(re.fullmatch("'(.*)'", given["hydra.run.dir"])[1])
template = place.parents[1] / given["seed"]
if not template.exists():
    sys.exit("Error: no motion hits the target")
shutil.copytree(template, place)
"""


@pytest.fixture
def study(tmp_path):
    """Return the ledger and command of a study of three runs.

    The first hits in its second cast, the second not in five, the third fails.
    """
    leave_run(tmp_path / "0", [False, True])
    leave_run(tmp_path / "1", [False] * 5)
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    ledger = Ledger(tmp_path / "study")
    for seed in range(3):
        overrides = (f"seed={seed}", "+experiment=paper", "name=wall")
        ledger.add(Job(seed, overrides, {"name": "wall", "seed": seed, "max_casts": 5}))
    return ledger, (sys.executable, "-S", str(tmp_path / "stand_in.py"))


def test_a_study_goes_on_and_scores_what_has_ended(study, undrawn):
    ledger, command = study
    keys = [job.key for job in ledger.jobs()]
    Attempt(ledger.folder, keys[0], command)(1)
    finish(ledger.folder)
    assert "1 of 3 runs have ended" in page_of(ledger)
    for key in ledger.reset_unfinished(keys, ()):
        Attempt(ledger.folder, key, command)(1)
    assert [job.state for job in finish(ledger.folder)] == [
        DONE_STATE,
        DONE_STATE,
        FAILED_STATE,
    ]
    ended = store.read_table(scores.RUNS, ledger.folder / "runs.parquet")
    assert ended["hit_at"].tolist() == [2, INF, INF]
    assert ended["casts"].tolist() == [2, 5, 0]
    casts = store.read_table(scores.CASTS, ledger.folder / "casts.parquet")
    assert casts[casts["hit"]][["seed", "cast"]].to_numpy().tolist() == [[0, 2]]
    within = store.read_table(scores.RATES, ledger.folder / "rates.parquet").set_index(
        "within"
    )
    assert within["right"].tolist() == [0, 1, 1, 1, 1]
    assert (within["count"] == 3).all()
    assert "no motion hits the target" in page_of(ledger)
    assert all((ledger.folder / f"{table.name}.parquet").exists() for table in TABLES)


def page_of(ledger):
    page = (ledger.folder / "report.html").read_text()
    for forbidden in ("http://", "https://", "<script", ">nan<"):
        assert forbidden not in page.replace("http://www.w3.org", "")
    return re.sub(r"\s+", " ", page)


def test_figures_show_what_the_runs_stored(study):
    ledger, command = study
    for job in ledger.jobs()[:2]:
        Attempt(ledger.folder, job.key, command)(1)
    finish(ledger.folder)
    tables = {
        table.name: store.read_table(table, ledger.folder / f"{table.name}.parquet")
        for table in TABLES
    }
    drawn = paper_figures(PaperRecord(tables, 2, {}, {}))
    assert set(drawn) == {"fig_13", "fig_14"}
    assert all((ledger.folder / f"{name}.png").stat().st_size > 5000 for name in drawn)
    first, last = drawn["fig_13"].figure.axes
    assert "cast 1, missed by 50 mm" in first.get_title()
    assert "cast 2, hit" in last.get_title()
    for axes in (first, last):
        assert len(axes.lines) == 3 * figure_data.MOMENTS
        assert len(axes.patches) == 2  # target and wall
    measured = first.lines[-1]
    assert measured.get_ydata() == pytest.approx((0.8 - S + 0.9 * 0.2) * 1e3)
    assert "E is 0.400 in cast 1, 0.400 in cast 2: not higher" in drawn["fig_14"].alt
    curves = [
        line
        for line in drawn["fig_14"].figure.axes[0].lines
        if len(line.get_xdata()) == len(T)
    ]
    assert len(curves) == 2
