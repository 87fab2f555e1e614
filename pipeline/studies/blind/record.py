"""Put a study into the table of all that were recorded: `python -m pipeline.studies.blind.record [FOLDER ...]`.

FOLDER is the run's folder of a study. A row that is there already (laboratory, seed, version and code) stays. Without a
folder the table is only shown. Figures are of one code and one laboratory each: they are never counted together.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from stringcast.data import store
from stringcast.pipeline.provenance import ROOT, software
from stringcast.pipeline.studies.blind.scores import BENCHES, COUNTED, OWN
from stringcast.pipeline.studies.counts import bars, counted
from stringcast.stages.report.theme import LIGHT, STYLE

FOLDER = ROOT / "data" / "results" / "blind_study"
SHOWN = {"cause found": "before", "false alarm": "measured", "outside called unknown": "after"}


def main() -> None:
    """Append, draw, and print the figures as a table in Markdown."""
    parser = argparse.ArgumentParser("python -m pipeline.studies.blind.record", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="*", help="run folders of +experiment=blind_study")
    table = FOLDER / "benches.parquet"
    folders = parser.parse_args().folders
    benches = appended([store.read_table(BENCHES, path) for path in (table, *(f / table.name for f in folders))])
    if folders:
        store.write_table(BENCHES, benches, table, software())
    rates = by_code(benches)
    picture(rates, FOLDER / "codes.png")
    print(in_markdown(rates))


def appended(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """All rows, in order; of one bench that one code was asked twice, the first."""
    benches = pd.concat([completed(table) for table in tables], ignore_index=True)
    return benches.drop_duplicates(["laboratory", "seed", "version", "code"], ignore_index=True)


def completed(benches: pd.DataFrame) -> pd.DataFrame:
    """The benches with what older tables do not say: their laboratory, which was the virtual lab itself, and what half
    of their trials named, which was not asked."""
    benches = benches.assign(laboratory=benches.get("laboratory", OWN))
    return benches.assign(half=benches.get("half", ""), lost=benches.get("lost", 0))


def by_code(benches: pd.DataFrame) -> pd.DataFrame:
    """A row for each code, laboratory and rate, in the table's order: code, laboratory, benches, name, right, count,
    share, low, high."""
    rows = []
    for (one, laboratory), some in completed(benches).groupby(["code", "laboratory"], sort=False):
        inside = pd.Series([value["inside"] for kept in some["values"] for value in json.loads(kept)], dtype=bool)
        chosen = {name: of(some[some["kind"].isin(kinds)]) for name, kinds, of, _, _ in COUNTED}
        about = {"code": one, "laboratory": laboratory, "benches": len(some)}
        for name, right in {**chosen, "parameter in its interval": inside}.items():
            rows.append({**about, "name": name, **counted(right)})
    return pd.DataFrame(rows)


def in_markdown(rates: pd.DataFrame) -> str:
    """A line for each code and laboratory, a column for each rate, with its 95 % interval in per cent."""
    names = list(dict.fromkeys(rates["name"]))
    lines = [f"| code | laboratory | benches | {' | '.join(names)} |", "| --- " * (len(names) + 3) + "|"]
    for (one, laboratory), some in rates.groupby(["code", "laboratory"], sort=False):
        cells = [
            f"{k} of {n} ({100 * low:.1f} to {100 * high:.1f})" if n else ""
            for k, n, low, high in some[["right", "count", "low", "high"]].itertuples(index=False)
        ]
        lines.append(f"| {str(one)[:7]} | {laboratory} | {some['benches'].iloc[0]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def picture(rates: pd.DataFrame, path: Path) -> None:
    """Shares over the codes, with their intervals; another laboratory's name stands behind the code."""
    with plt.style.context(STYLE):
        figure, axes = plt.subplots(figsize=(10, 4))
        labels = rates["code"].str[:7] + (" " + rates["laboratory"]).where(rates["laboratory"] != OWN, "")
        place = rates.groupby(["code", "laboratory"], sort=False).ngroup()
        for number, (name, colour) in enumerate(SHOWN.items()):
            some = rates[(rates["name"] == name) & (rates["count"] > 0)]
            across = place[some.index] + 0.2 * (number - 1)
            axes.errorbar(across, some["share"], bars(some), fmt="o", ms=4, color=LIGHT[colour], label=name)
        first = ~place.duplicated()
        axes.set_xticks(place[first], labels[first], rotation=60, ha="right")
        axes.set(ylabel="share, with its 95 % interval", ylim=(-0.03, 1.03), xlabel="code, in the order of time")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=len(SHOWN))
        figure.savefig(path, dpi=120, facecolor="white")
        plt.close(figure)


if __name__ == "__main__":
    main()
