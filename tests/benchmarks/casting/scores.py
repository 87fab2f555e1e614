"""Scores of a casting study.

How many runs have hit after how many casts, and whether predicted chances hold.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.schema import Column, Table
from stringcast.pipeline.paper.scores import SHARE_COLUMNS, share_with_interval

PROBABILITY_BINS = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 1.0])
TARGET_SHARE = 0.95  # share of the runs that must have hit
ALL_CASES = "all"
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
TABLES = {table.name: table for table in (CASTS, RATES, NEEDED, LEARNED, CALIBRATION)}


def score_casts(casts: pd.DataFrame, max_casts: int) -> dict[str, pd.DataFrame]:
    """Return all tables.

    `casts` is table CASTS, in which runs may lack columns. `max_casts` is the number of
    casts of a run.
    """
    casts = CASTS.check(
        casts.reindex(columns=[column.name for column in CASTS.columns])
    )
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
