"""How often it hit and how many manipulations that took, from the runs' own records;
and the numbers that the paper prints of it, from one file, each with its place there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, quantile_test

from stringcast.data.schema import Column, Table
from stringcast.pipeline.sweep.ledger import DONE_STATE, FAILED_STATE, Job, Ledger
from stringcast.pipeline.sweep.table import setting_columns

FILE = Path(__file__).with_name("numbers.csv")
NINE = tuple(
    f"{string}_{target}"
    for string in "ABC"
    for target in ("300_900", "400_700", "500_900")
)
CONDITION = "name"  # the setting that names a job's experiment
_EXPERIMENT = Column(
    "condition",
    "",
    "experiment of conf/experiment/paper.yaml; nine: three strings, three targets",
    "text",
)
SHARE_COLUMNS = (
    Column("right", "1", "how many of them", "int"),
    Column("count", "1", "of how many", "int"),
    Column("share", "1", "right over count; NaN of none"),
    Column("low", "1", "lower end of the 95 % interval (Clopper and Pearson)"),
    Column("high", "1", "upper end"),
)
_SEED = Column("seed", "1", "of the run", "int")
RUNS = Table(
    "runs",
    "a row a run that ended; one that failed counts as one that never hit",
    (
        _EXPERIMENT,
        _SEED,
        Column("state", "", "done or failed", "text"),
        Column("error", "", "why it failed", "text"),
        Column(
            "hit_at",
            "1",
            "manipulation in which the tip reached the target; infinite if in none",
        ),
        Column("manipulations", "1", "casts made", "int"),
        Column("budget", "1", "casts allowed", "int"),
        Column("seconds", "s", "that the run took"),
        Column("folder", "", "the run's, relative to this file", "text"),
    ),
)
CASTS = Table(
    "casts",
    "a row a cast",
    (
        _EXPERIMENT,
        _SEED,
        Column("manipulation", "1", "number of the cast, from 1", "int"),
        Column(
            "hit",
            "",
            "the tip reached the target, the string clear of obstacles",
            "bool",
        ),
        Column("miss_m", "m", "closest approach of the tip to the target's centre"),
        Column("t_closest", "s", "when that was"),
        Column(
            "touched",
            "1",
            "frames of the movement in which the string lies in an obstacle",
            "int",
        ),
        Column(
            "E_before",
            "1",
            "matching rate of the parameters with which the motion was made",
        ),
        Column("E_after", "1", "matching rate after estimation"),
    ),
)
RATES = Table(
    "rates",
    "how many runs hit within so many manipulations",
    (
        _EXPERIMENT,
        Column("within", "1", "manipulations", "int"),
        *SHARE_COLUMNS,
    ),
)
NEEDED = Table(
    "needed",
    "manipulations until the tip hit; infinite where it did not within the budget",
    (
        _EXPERIMENT,
        Column("count", "1", "runs", "int"),
        Column("median", "1", "half of the runs needed no more"),
        Column(
            "low",
            "1",
            "lower end of the median's 95 % interval (order statistics); NaN for too few runs",
        ),
        Column("high", "1", "upper end"),
        Column(
            "paper",
            "1",
            "what the paper needed in its one run; NaN where it does not say",
        ),
    ),
)

NUMBERS = Table(
    "numbers",
    "numbers that the paper prints; units as printed, with Nm written N m",
    (
        Column(
            "what",
            "",
            "minimum and maximum of Table 3, a column of Table 4, hit_at, or a setting",
            "text",
        ),
        Column("of", "", "parameter, string, or experiment", "text"),
        Column("value", "", "as printed, in SI"),
        Column("unit", "", "as printed", "text"),
        Column("place", "", "in the paper", "text"),
    ),
)


def numbers() -> pd.DataFrame:
    """Table NUMBERS."""
    return NUMBERS.check(pd.read_csv(FILE), str(FILE))


def of(what: str) -> dict[str, float]:
    """Values of one kind, by what they are of."""
    table = numbers()
    some = table[table["what"] == what]
    return dict(zip(some["of"], some["value"], strict=True))


def runs(ledger: Ledger, jobs: Sequence[Job]) -> pd.DataFrame:
    """Table RUNS of the jobs that ended."""
    rows = []
    for job, condition in zip(jobs, setting_columns(jobs)[CONDITION], strict=True):
        if job.state in (DONE_STATE, FAILED_STATE):
            made = (
                list(_casts(ledger.job_folder(job.key)))
                if job.state == DONE_STATE
                else []
            )
            hits = [cast["manipulation"] for cast in made if cast["hit"]]
            row = {
                "condition": condition,
                "seed": job.settings["seed"],
                "state": job.state,
                "error": job.error,
            }
            row |= {"hit_at": min(hits, default=np.inf), "manipulations": len(made)}
            row |= {
                "budget": job.settings["max_casts"],
                "seconds": job.seconds,
                "folder": job.key,
            }
            rows.append(row)
    return RUNS.check(pd.DataFrame(rows)) if rows else RUNS.empty()


def pooled(of_runs: pd.DataFrame) -> pd.DataFrame:
    """Table RUNS with those of three strings to three targets once more, as one
    experiment.
    """
    return pd.concat(
        [of_runs, of_runs[of_runs["condition"].isin(NINE)].assign(condition="nine")],
        ignore_index=True,
    )


def casts(ledger: Ledger, of_runs: pd.DataFrame) -> pd.DataFrame:
    """Table CASTS. of_runs: table RUNS."""
    rows = [
        {"condition": run.condition, "seed": run.seed, **cast}
        for run in of_runs[of_runs["state"] == DONE_STATE].itertuples()
        for cast in _casts(ledger.folder / run.folder)
    ]
    return CASTS.check(pd.DataFrame(rows)) if rows else CASTS.empty()


def rates(of_runs: pd.DataFrame) -> pd.DataFrame:
    """Table RATES. of_runs: table RUNS."""
    rows = [
        {
            "condition": condition,
            "within": within,
            **share_with_interval(some["hit_at"] <= within),
        }
        for condition, some in of_runs.groupby("condition", sort=False)
        for within in range(1, int(some["budget"].max()) + 1)
    ]
    return RATES.check(pd.DataFrame(rows)) if rows else RATES.empty()


def needed(of_runs: pd.DataFrame) -> pd.DataFrame:
    """Table NEEDED. of_runs: table RUNS."""
    printed = of("hit_at")
    rows = [
        {
            "condition": condition,
            "paper": printed.get(str(condition), np.nan),
            **median(some["hit_at"].to_numpy()),
        }
        for condition, some in of_runs.groupby("condition", sort=False)
    ]
    return NEEDED.check(pd.DataFrame(rows)) if rows else NEEDED.empty()


def share_with_interval(right: pd.Series) -> dict[str, float]:
    """Count true values: SHARE_COLUMNS, with the exact 95 % interval."""
    n, k = len(right), int(right.sum())
    if n == 0:
        return {"right": 0, "count": 0, "share": np.nan, "low": 0.0, "high": 1.0}
    interval = binomtest(k, n).proportion_ci(0.95, method="exact")
    return {
        "right": k,
        "count": n,
        "share": k / n,
        "low": interval.low,
        "high": interval.high,
    }


def median(values: np.ndarray) -> dict[str, float]:
    """The lower median of (K,) values, and its exact 95 % interval, NaN where K is too
    small for one.

    Order statistics, so infinite values are no trouble.
    """
    middle = float(np.sort(values)[(len(values) - 1) // 2])
    ends = quantile_test(values, q=middle, p=0.5).confidence_interval(0.95)
    return {
        "count": len(values),
        "median": middle,
        "low": float(ends.low),
        "high": float(ends.high),
    }


def _casts(folder: Path) -> Iterator[dict[str, Any]]:
    """The casts of a run, from its run.json."""
    for cast in json.loads((folder / "run.json").read_text(encoding="utf-8"))[
        "iterations"
    ]:
        yield {"manipulation": cast.pop("number"), **cast}
