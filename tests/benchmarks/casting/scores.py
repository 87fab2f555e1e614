"""Scores of a casting study.

How many runs have hit after how many casts, and whether predicted chances hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stringcast.data.schema import Column, Table
from stringcast.pipeline.paper.scores import SHARE_COLUMNS, share_with_interval
from stringcast.stages.explain.decision import NAMED_PROBABILITY
from stringcast.stages.surprise.surprise import ALARM_P_VALUE
from tests.benchmarks.simulators.causes import LIBRARY_CAUSES, OUTSIDE_CAUSES

PROBABILITY_BINS = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 1.0])
TARGET_SHARE = 0.95  # share of the runs that must have hit
ALL_CASES = "all"
SHIFT_THAT_MATTERS_M = 0.02  # of the tip: the width of the target
SURE_HIT = 0.9  # stated probability
NEAR_M = (0.05, 0.1)  # of the real tip from the centre of the target
_WHICH = (
    Column("case", "", "string and target; 'all' for all together", "text"),
    Column("method", "", "", "text"),
)
CASTS = Table(
    "casts",
    "a row a cast, until one hits",
    (
        *_WHICH,
        Column("seed", "1", "of the run; the same for all methods", "int"),
        Column("cast", "1", "its number, from 1", "int"),
        Column(
            "hit",
            "",
            "the real tip entered the box during the movement, clear of obstacles",
            "bool",
        ),
        Column("believed", "", "the measured tip did, so that the run ends", "bool"),
        Column(
            "distance",
            "m",
            "smallest distance of the real tip from the centre of the box",
        ),
        Column(
            "probability",
            "1",
            "predicted probability of a hit; NaN where the method predicts none",
        ),
        Column("planning", "s", "processor time of planning"),
        Column("learning", "s", "processor time of what follows a trial"),
        Column(
            "looking",
            "s",
            "processor time of the look before the first cast and of what follows it",
            optional=True,
        ),
        Column(
            "residual",
            "m",
            "rms distance of simulated and measured string after estimation",
        ),
        Column(
            "prediction_error",
            "m",
            "rms error of the tip in casts that nothing was fitted to, after estimation",
        ),
        Column(
            "effects", "", "effects of the method's model beyond the paper's", "text"
        ),
        Column("hidden", "", "causes that the world hides", "text"),
        Column(
            "hidden_shift",
            "m",
            "rms distance by which they move the measured tip in this cast",
        ),
        Column(
            "p_value",
            "1",
            "of the trial, by what was predicted; NaN where the method does not test",
        ),
        Column("verdict", "", "of the search for causes", "text"),
        Column(
            "causes",
            "",
            "what it found, as name=probability, separated by spaces",
            "text",
        ),
        Column(
            "code",
            "",
            "commit of the code that cast, + if it was changed since",
            "text",
            optional=True,
        ),
    ),
)
RATES = Table(
    "rates",
    "runs that have hit within so many casts",
    (*_WHICH, Column("within", "1", "casts", "int"), *SHARE_COLUMNS),
)
NEEDED = Table(
    "needed",
    "casts until the share of runs that have hit is 95 %",
    (
        *_WHICH,
        Column("casts", "1", "NaN where it is not reached"),
        Column("runs", "1", "how many", "int"),
    ),
)
LEARNED = Table(
    "learned",
    "prediction error of the tip after so many casts",
    (
        *_WHICH,
        Column("after", "1", "casts", "int"),
        Column("median", "m", "over runs; a run that has hit keeps its last value"),
    ),
)
CALIBRATION = Table(
    "calibration",
    "predicted probabilities of a hit, and the share that hit",
    (
        Column("method", "", "", "text"),
        Column("from", "1", "predicted probability"),
        Column("to", "1", ""),
        Column("predicted", "1", "mean"),
        *SHARE_COLUMNS,
    ),
)
FIRST_CASTS = Table(
    "first_casts",
    "how near first casts come",
    (
        *_WHICH,
        Column("outcome", "", "what is counted", "text"),
        *SHARE_COLUMNS,
        Column("miss", "m", "mean distance of the tip from the target's centre"),
    ),
)
FINDINGS = Table(
    "findings",
    "how often surprise and causes are right, by cast",
    (
        Column("method", "", "", "text"),
        Column("finding", "", "what is counted", "text"),
        *SHARE_COLUMNS,
    ),
)
TABLES = {
    table.name: table
    for table in (CASTS, RATES, NEEDED, LEARNED, CALIBRATION, FIRST_CASTS, FINDINGS)
}


def score_casts(casts: pd.DataFrame, max_casts: int) -> dict[str, pd.DataFrame]:
    """Return all tables.

    `casts` is table CASTS, in which runs may lack columns. `max_casts` is the number of
    casts of a run.
    """
    casts = casts.reindex(columns=[column.name for column in CASTS.columns])
    texts = [column.name for column in CASTS.columns if column.kind == "text"]
    casts = CASTS.check(casts.assign(**casts[texts].astype(object).fillna("")))
    runs = casts.assign(run=casts["case"] + casts["seed"].astype(str))
    runs = pd.concat([runs, runs.assign(case=ALL_CASES)], ignore_index=True)
    counts: list[dict[str, object]] = []
    learned = []
    for (case, method), rows in runs.groupby(["case", "method"], sort=False):
        which = {"case": case, "method": method}
        first_hit = (
            rows["cast"].where(rows["hit"].astype(bool)).groupby(rows["run"]).min()
        )
        for within in range(1, max_casts + 1):
            counts.append(
                {"within": within, **share_with_interval(first_hit <= within), **which}
            )
        errors = rows.pivot_table(
            index="run", columns="cast", values="prediction_error", dropna=False
        )
        # a run that has hit learns nothing more
        errors = errors.reindex(columns=range(1, max_casts + 1)).ffill(axis=1)
        learned.append(
            pd.DataFrame(
                {"after": errors.columns, "median": errors.median().to_numpy(), **which}
            )
        )

    rates = pd.DataFrame(counts)
    needed = []
    for (case, method), rows in rates.groupby(["case", "method"], sort=False):
        enough = rows.loc[rows["share"] >= TARGET_SHARE, "within"]
        needed.append(
            {
                "case": case,
                "method": method,
                "casts": enough.min(),
                "runs": rows["count"].iloc[0],
            }
        )
    return {
        "casts": casts,
        "rates": rates,
        "needed": pd.DataFrame(needed),
        "learned": pd.concat(learned),
        "calibration": count_calibration(casts),
        "first_casts": count_first_casts(runs[runs["cast"] == 1]),
        "findings": count_findings(casts),
    }


def count_calibration(casts: pd.DataFrame) -> pd.DataFrame:
    """Return table CALIBRATION of table CASTS."""
    predicted = casts[casts["probability"].notna()]
    bins = np.clip(
        np.digitize(predicted["probability"], PROBABILITY_BINS) - 1,
        0,
        len(PROBABILITY_BINS) - 2,
    )
    rows = []
    for (method, i), group in predicted.groupby(["method", bins], sort=False):
        row = {
            "method": method,
            "from": PROBABILITY_BINS[i],
            "to": PROBABILITY_BINS[i + 1],
        }
        row |= {
            "predicted": group["probability"].mean(),
            **share_with_interval(group["hit"]),
        }
        rows.append(row)
    return pd.DataFrame(rows) if rows else CALIBRATION.empty()


def count_first_casts(casts: pd.DataFrame) -> pd.DataFrame:
    """Return table FIRST_CASTS of the first casts in table CASTS.

    A run without a motion has no distance; it counts as a miss, and not in the mean.
    """
    rows = []
    for (case, method), group in casts.groupby(["case", "method"], sort=False):
        outcomes = {"hit": group["hit"].astype(bool)}
        for limit_m in NEAR_M:
            name = f"within {1e3 * limit_m:.0f} mm"
            outcomes[name] = group["distance"] <= limit_m
        for name, outcome in outcomes.items():
            which = {"case": case, "method": method, "outcome": name}
            miss = {"miss": group["distance"].mean()}
            rows.append(which | share_with_interval(outcome) | miss)
    return pd.DataFrame(rows)


def right_names(hidden: Sequence[str]) -> set[str]:
    """Return the names by which the library may call hidden causes."""
    causes = {cause.name: cause for cause in (*LIBRARY_CAUSES, *OUTSIDE_CAUSES)}
    names: set[str] = set()
    for name in hidden:
        if name not in causes:  # an effect that only the virtual lab hides
            names.add(name)
        elif not causes[name].outside:
            names |= {name, *causes[name].alike}
    return names


def count_findings(casts: pd.DataFrame) -> pd.DataFrame:
    """Return table FINDINGS of table CASTS."""
    rows: list[dict[str, object]] = []
    searched = casts[casts["verdict"] != ""]
    for method, group in searched.groupby("method", sort=False):
        named = group["causes"].where(group["verdict"] == "cause", "")
        is_known, is_right, is_false = [], [], []
        for causes, hidden in zip(named, group["hidden"], strict=True):
            names = set()
            for cause in causes.split():
                name, _, probability = cause.partition("=")
                if float(probability) >= NAMED_PROBABILITY:
                    names.add(name)
            right = right_names(hidden.split())
            is_known.append(bool(right))
            is_right.append(bool(names & right))
            is_false.append(bool(names - right))
        moved = (group["hidden_shift"] > SHIFT_THAT_MATTERS_M).to_numpy()
        matters = moved & np.array(is_known)
        alarm = group["p_value"] <= ALARM_P_VALUE
        tested = group["p_value"].notna()
        nothing = tested & (group["hidden"] == "")
        sure_miss = tested & (group["probability"] >= SURE_HIT) & ~group["hit"]
        counted = {
            "a hidden cause of the library that matters is named": pd.Series(is_right)[
                matters
            ],
            "another cause is named": pd.Series(is_false),
            "a surprise where nothing is hidden": alarm[nothing],
            "no surprise at a miss that was hardly possible": ~alarm[sure_miss],
        }
        for finding, outcomes in counted.items():
            if len(outcomes):
                shares = share_with_interval(outcomes)
                rows.append({"method": method, "finding": finding, **shares})
    return pd.DataFrame(rows) if rows else FINDINGS.empty()
