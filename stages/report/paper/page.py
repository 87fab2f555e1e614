"""The page: each of the paper's experiments with what came of it here, and whether the two agree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib import style

from stringcast.stages.report.paper.figures import ONE_MOTION
from stringcast.stages.report.paper.record import LABELS, Drawn, PaperRecord
from stringcast.stages.report.picture import STYLE, Picture, vector
from stringcast.stages.report.template import template

# What stands above each figure, the experiments it is of, and what the paper says about them.
SECTIONS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "fig_07": ("Fig. 7: string A to (500, 900)", ("A_500_900",), "The first manipulation hits, with another shape."),
    "fig_08": ("Fig. 8: string C to (300, 900)", ("C_300_900",), "The first manipulation hits, with another shape."),
    "fig_09": ("Fig. 9: string B to (400, 700)", ("B_400_700",), "The first manipulation misses, the second hits."),
    "fig_10": (
        "Fig. 10: way of the hand",
        (),
        "To (300, 900) and (400, 700) the arm swings up, to (900, 500) it swings down.",
    ),
    "fig_11": (
        "Fig. 11: three strings, one first motion",
        ONE_MOTION,
        "All three hit once the procedure was repeated; how often is not said.",
    ),
    "table_4": (
        "Table 4: estimated parameters",
        (),
        "k_h and c_h are found at an end of their ranges, k_ph and c_ph in between.",
    ),
    "fig_12": ("Fig. 12: string D, n = 25", ("D_500_500",), "It hits; in which manipulation is not said."),
    "fig_13": ("Fig. 13: around a wall", ("wall",), "It hits in the fifth manipulation."),
    "fig_14": (
        "Fig. 14: E over time, around the wall",
        (),
        "E of the fourth manipulation is higher than that of the first around the moment of the hit.",
    ),
}


def paper_report(record: PaperRecord, drawn: Mapping[str, Drawn]) -> str:
    """The page as text; the same record gives the same page. drawn: its `figures`."""
    with style.context(STYLE):
        pictures = {name: vector(one.figure, one.alt) for name, one in drawn.items()}
    return template("paper/page.html.j2", share).render(
        record=record,
        labels=LABELS,
        overview=pictures.get("hit_rates"),
        sections=[_section(record, name, pictures[name]) for name in SECTIONS if name in pictures],
        rows=[_row(record, name) for name in record.conditions],
        failed=record.tables["runs"].query("state == 'failed'").to_dict("records"),
        numbers=record.tables["numbers"].to_dict("records"),
    )


def share(row: pd.Series) -> str:
    """A rate with its interval, in percent."""
    return f"{100 * row['share']:.0f} ({100 * row['low']:.0f} to {100 * row['high']:.0f}) %"


def _section(record: PaperRecord, name: str, picture: Picture) -> dict[str, Any]:
    """A figure, with what the paper says and what came out here."""
    title, conditions, paper = SECTIONS[name]
    here = [outcome(record, condition) for condition in conditions if condition in record.conditions]
    return {"title": title, "picture": picture, "paper": paper, "here": " ".join([*here, picture.alt])}


def outcome(record: PaperRecord, condition: str) -> str:
    """How many runs hit, and whether that is what the paper saw in its one run."""
    table = record.of("rates", condition).set_index("within")
    needed = record.of("needed", condition).iloc[0]
    within = int(needed["paper"]) if needed["paper"] == needed["paper"] else int(table.index.max())
    one = table.loc[within]
    said = f"{LABELS[condition]}: {one['right']:.0f} of {one['count']:.0f} runs hit within {within}"
    if needed["paper"] != needed["paper"]:
        return f"{said}."
    alike = "as in the paper" if one["share"] >= 0.5 else "unlike the paper's one run"
    return f"{said}, {alike}."


def _row(record: PaperRecord, condition: str) -> dict[str, Any]:
    """What the table of hit rates says of one experiment."""
    table = record.of("rates", condition).set_index("within")
    return {
        "label": LABELS[condition],
        "rates": [table.loc[within] for within in table.index],
        "needed": record.of("needed", condition).iloc[0],
    }
