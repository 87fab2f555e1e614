"""Scores of a hit study, as tables: how many runs have hit after so many casts, and
whether predicted chances hold.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from stringcast.data.schema import Column, Table
from stringcast.pipeline.studies.counts import COUNTS, UNKNOWN_CODE, counted

BINS = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 1.0])  # of the predicted chance
WANTED = 0.95  # share of the runs within whose casts the tip has hit
ALL = "all"
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
        Column(
            "believed",
            "",
            "so did the measured tip as the method's model sees it, so that it casts no more",
            "bool",
        ),
        Column("distance", "m", "of the real tip from the box's centre, the least"),
        Column(
            "chance", "1", "of hitting, predicted; NaN where the method predicts none"
        ),
        Column("planning", "s", "processor time that planning took"),
        Column(
            "residual",
            "m",
            "between simulated and measured string after estimation, root mean square",
        ),
        Column(
            "foretelling",
            "m",
            "of the tip on casts nobody learned from, after estimation, root mean square",
        ),
        Column(
            "effects", "", "beyond the paper's that the method's model knows", "text"
        ),
        Column(
            "code",
            "",
            "commit of the code that cast, + if it was changed since; 'unknown' where nothing says",
            "text",
            optional=True,  # rows of studies that were begun before they said so
        ),
    ),
)
RATES = Table(
    "rates",
    "runs that have hit within so many casts",
    (*_WHICH, Column("within", "1", "casts", "int"), *COUNTS),
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
    "how well a model predicts the tip on casts nobody learned from, after so many casts",
    (
        *_WHICH,
        Column("after", "1", "casts", "int"),
        Column("median", "m", "over runs; a run that has hit stays"),
    ),
)
CALIBRATION = Table(
    "calibration",
    "predicted chances, and what came of them",
    (
        Column("method", "", "", "text"),
        Column("from", "1", "predicted chance"),
        Column("to", "1", ""),
        Column("foretold", "1", "mean"),
        *COUNTS,
    ),
)
TABLES = {table.name: table for table in (CASTS, RATES, NEEDED, LEARNED, CALIBRATION)}


def scores(casts: pd.DataFrame, most: int) -> dict[str, pd.DataFrame]:
    """All tables. casts: as CASTS. most: casts that a run had at most."""
    columns = casts.reindex(columns=[column.name for column in CASTS.columns])
    whole = CASTS.check(columns.astype({"code": object}).fillna({"code": UNKNOWN_CODE}))
    runs = whole.assign(run=whole["case"] + whole["seed"].astype(str))
    both = pd.concat([runs, runs.assign(case=ALL)], ignore_index=True).groupby(
        ["case", "method"], sort=False
    )
    counts: list[dict[str, object]] = []
    learned = []
    for (case, method), some in both:
        first = some["cast"].where(some["hit"].astype(bool)).groupby(some["run"]).min()
        which = {"case": case, "method": method}
        counts += [
            {"within": within, **counted(first <= within), **which}
            for within in range(1, most + 1)
        ]
        wide = some.pivot_table(
            index="run", columns="cast", values="foretelling", dropna=False
        )
        # a run that has hit keeps what it learned
        stays = wide.reindex(columns=range(1, most + 1)).ffill(axis=1)
        learned.append(
            pd.DataFrame(
                {"after": stays.columns, "median": stays.median().to_numpy(), **which}
            )
        )
    rates = pd.DataFrame(counts)
    needed = [
        {
            "case": case,
            "method": method,
            "casts": some.loc[some["share"] >= WANTED, "within"].min(),
        }
        | {"runs": some["count"].iloc[0]}
        for (case, method), some in rates.groupby(["case", "method"], sort=False)
    ]
    return {
        "casts": whole,
        "rates": rates,
        "needed": pd.DataFrame(needed),
        "learned": pd.concat(learned),
        "calibration": _calibration(whole),
    }


def _calibration(casts: pd.DataFrame) -> pd.DataFrame:
    predicted = casts[casts["chance"].notna()]
    place = np.clip(np.digitize(predicted["chance"], BINS) - 1, 0, len(BINS) - 2)
    rows = [
        {
            "method": m,
            "from": BINS[i],
            "to": BINS[i + 1],
            "foretold": some["chance"].mean(),
            **counted(some["hit"]),
        }
        for (m, i), some in predicted.groupby(["method", place], sort=False)
    ]
    return pd.DataFrame(rows) if rows else CALIBRATION.empty()
