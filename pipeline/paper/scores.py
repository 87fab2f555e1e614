"""Hit rates and needed casts of runs, and the paper's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, quantile_test

from stringcast.data.schema import Table, parse_columns
from stringcast.pipeline.sweep.ledger import DONE_STATE, FAILED_STATE, Job, Ledger
from stringcast.pipeline.sweep.table import setting_columns

NUMBERS_FILE = Path(__file__).with_name("numbers.csv")
POOLED_TARGETS = ("300_900", "400_700", "500_900")
POOLED_EXPERIMENTS = [
    f"{string}_{target}" for string in "ABC" for target in POOLED_TARGETS
]
POOL_NAME = "nine"
EXPERIMENT_SETTING = "name"  # the setting that names a job's experiment
SHARE_COLUMNS = parse_columns("""
    right [1] (int): number of hits
    count [1] (int): number of runs
    share [1]: right over count; NaN without runs
    low [1]: lower end of the 95 % interval (Clopper and Pearson)
    high [1]: upper end
    """)
RUNS = Table(
    "runs",
    "a row for each run that ended; a failed one counts as one that never hit",
    parse_columns("""
    condition (text): experiment of paper.yaml; nine: three strings, three targets
    seed [1] (int): seed of the run
    state (text): done or failed
    error (text): why it failed
    hit_at [1]: cast in which the tip reached the target; infinite if in none
    casts [1] (int): casts made
    budget [1] (int): casts allowed
    seconds [s]: duration of the run
    folder (text): folder of the run, relative to this file
    """),
)
CASTS = Table(
    "casts",
    "a row for each cast",
    parse_columns("""
    condition (text): experiment of paper.yaml; nine: three strings, three targets
    seed [1] (int): seed of the run
    cast [1] (int): number of the cast, from 1
    hit (bool): the tip reached the target and the string touched no obstacle
    miss_m [m]: closest approach of the tip to the target's centre
    t_closest [s]: time of the closest approach
    touched [1] (int): frames in which the string lies in an obstacle
    E_before [1]: matching rate of the parameters used for the motion
    E_after [1]: matching rate after estimation
    """),
)
RATES = Table(
    "rates",
    "runs that hit within some number of casts",
    (
        *parse_columns("""
        condition (text): experiment of paper.yaml; nine: three strings, three targets
        within [1] (int): casts
        """),
        *SHARE_COLUMNS,
    ),
)
NEEDED = Table(
    "needed",
    "casts until the tip hit; infinite if it did not within the budget",
    parse_columns("""
    condition (text): experiment of paper.yaml; nine: three strings, three targets
    count [1] (int): runs
    median [1]: half of the runs needed no more casts
    low [1]: lower end of the median's 95 % interval; NaN for too few runs
    high [1]: upper end
    paper [1]: casts in the paper's one run; NaN if not stated
    """),
)

NUMBERS = Table(
    "numbers",
    "numbers that the paper prints, in its units",
    parse_columns("""
    what (text): bound of Table 3, column of Table 4, hit_at, or a setting
    of (text): parameter, string, or experiment
    value: printed value, in SI units
    unit (text): printed unit
    place (text): place in the paper
    """),
)


def read_printed_numbers() -> pd.DataFrame:
    """Read the table of the paper's printed numbers."""
    return NUMBERS.check(pd.read_csv(NUMBERS_FILE), str(NUMBERS_FILE))


def printed_values(kind: str) -> dict[str, float]:
    """Return the printed values of one kind, by parameter, string or experiment."""
    table = read_printed_numbers()
    rows = table[table["what"] == kind]
    return dict(zip(rows["of"], rows["value"], strict=True))


def run_table(ledger: Ledger, jobs: Sequence[Job]) -> pd.DataFrame:
    """Return table RUNS of the jobs that ended."""
    rows = []
    experiments = setting_columns(jobs)[EXPERIMENT_SETTING]
    for job, experiment in zip(jobs, experiments, strict=True):
        if job.state not in (DONE_STATE, FAILED_STATE):
            continue
        casts = []
        if job.state == DONE_STATE:
            casts = read_casts(ledger, job.key)
        hits = [cast["cast"] for cast in casts if cast["hit"]]
        row = {
            "condition": experiment,
            "seed": job.settings["seed"],
            "state": job.state,
            "error": job.error,
            "hit_at": min(hits, default=np.inf),
            "casts": len(casts),
            "budget": job.settings["max_casts"],
            "seconds": job.seconds,
            "folder": job.key,
        }
        rows.append(row)
    return RUNS.from_rows(rows)


def read_casts(ledger: Ledger, key: str) -> list[dict[str, Any]]:
    """Return the casts of a job with the names of table CASTS."""
    return [{"cast": cast.pop("number"), **cast} for cast in ledger.casts(key)]


def add_pooled_experiment(runs: pd.DataFrame) -> pd.DataFrame:
    """Append the runs of three strings and three targets as a pooled experiment."""
    pooled = runs[runs["condition"].isin(POOLED_EXPERIMENTS)]
    return pd.concat([runs, pooled.assign(condition=POOL_NAME)], ignore_index=True)


def cast_table(ledger: Ledger, runs: pd.DataFrame) -> pd.DataFrame:
    """Return table CASTS of the runs that are done."""
    rows = []
    for run in runs[runs["state"] == DONE_STATE].itertuples():
        for cast in read_casts(ledger, run.folder):
            rows.append({"condition": run.condition, "seed": run.seed, **cast})
    return CASTS.from_rows(rows)


def rate_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return table RATES of table RUNS."""
    rows = []
    for experiment, group in runs.groupby("condition", sort=False):
        for within in range(1, int(group["budget"].max()) + 1):
            share = share_with_interval(group["hit_at"] <= within)
            rows.append({"condition": experiment, "within": within, **share})
    return RATES.from_rows(rows)


def needed_cast_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Return table NEEDED of table RUNS."""
    rows = []
    printed = printed_values("hit_at")
    for experiment, group in runs.groupby("condition", sort=False):
        paper = printed.get(str(experiment), np.nan)
        median = median_with_interval(group["hit_at"].to_numpy())
        rows.append({"condition": experiment, "paper": paper, **median})
    return NEEDED.from_rows(rows)


def share_with_interval(right: pd.Series) -> dict[str, float]:
    """Count true values and return SHARE_COLUMNS, with the exact 95 % interval."""
    n, k = len(right), int(right.sum())
    if n == 0:
        return {"right": 0, "count": 0, "share": np.nan, "low": 0.0, "high": 1.0}
    low, high = binomtest(k, n).proportion_ci(0.95, method="exact")
    return {"right": k, "count": n, "share": k / n, "low": low, "high": high}


def median_with_interval(values: np.ndarray) -> dict[str, float]:
    """Return the lower median and its exact 95 % interval, from order statistics.

    Parameters
    ----------
    values : ndarray of shape (K,)
        Values, which may be infinite.

    Returns
    -------
    dict
        `count`, `median`, `low` and `high`; an end is NaN if K is too small.
    """
    median = float(np.sort(values)[(len(values) - 1) // 2])
    interval = quantile_test(values, q=median, p=0.5).confidence_interval(0.95)
    low, high = float(interval.low), float(interval.high)
    return {"count": len(values), "median": median, "low": low, "high": high}
