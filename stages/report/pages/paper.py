"""The page of the paper's experiments: its tables and figures, compared with ours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.report.charts.paper import (
    hand_paths_figure,
    matching_figure,
    string_shapes_figure,
    table_4_figure,
)
from stringcast.stages.report.formatting import (
    format_count,
    format_value,
    sentence_markup,
    symbol_markup,
    unit_markup,
)
from stringcast.stages.report.page import Page
from stringcast.stages.report.parts import (
    Container,
    Details,
    Figure,
    Section,
    TableView,
    Text,
    join_sentences,
    name_value_table,
    number_cell,
    number_cells,
    table_card,
)
from stringcast.stages.report.records import EXPERIMENT_LABELS, PaperFigure, PaperRecord
from stringcast.stages.report.theme import STYLE_SHEET, Picture, svg_picture

PAPER = (
    "Tabata, Seki, Tsuji and Hitamitsu, Casting manipulation of unknown string by "
    "robot arm (IROS 2021)"
)
ONE_MOTION_EXPERIMENTS = ("one_motion_A", "one_motion_B", "one_motion_C")
FIG_10_EXPERIMENTS = ("A_300_900", "A_400_700", "A_900_500")
MIN_RUNS_FOR_RATE = 20  # fewer give an interval wider than 45 points at one half
MAX_MANIPULATIONS = 99  # more than any run makes

# title of each figure, its experiments, and the paper's result
FIGURE_TEXTS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "fig_07": (
        "Fig. 7: string A to (500, 900)",
        ("A_500_900",),
        "The first cast hits, with another shape.",
    ),
    "fig_08": (
        "Fig. 8: string C to (300, 900)",
        ("C_300_900",),
        "The first cast hits, with another shape.",
    ),
    "fig_09": (
        "Fig. 9: string B to (400, 700)",
        ("B_400_700",),
        "The first cast misses, the second hits.",
    ),
    "fig_10": (
        "Fig. 10: hand path",
        (),
        "To (300, 900) and (400, 700) the arm swings up, to (900, 500) it swings down.",
    ),
    "fig_11": (
        "Fig. 11: three strings, one first motion",
        ONE_MOTION_EXPERIMENTS,
        "All three hit after repeating the procedure; how often is not stated.",
    ),
    "table_4": (
        "Table 4: estimated parameters",
        (),
        "k_h and c_h are found at an end of their ranges, k_ph and c_ph in between.",
    ),
    "fig_12": (
        "Fig. 12: string D, n = 25",
        ("D_500_500",),
        "It hits; in which cast is not stated.",
    ),
    "fig_13": (
        "Fig. 13: around a wall",
        ("wall",),
        "It hits in the fifth cast.",
    ),
    "fig_14": (
        "Fig. 14: E over time, around the wall",
        (),
        ("Around the hit, E of the fourth cast is higher than that of the first."),
    ),
}
# open points of the paper, and our choice
OPEN_CHOICES = (
    (
        (
            "does not give the strings' properties: B is harder than A, C softer, D "
            "the softest"
        ),
        "strings of the virtual lab (conf/specimen) that bend under their own weight "
        "over 131, 77, 45 and 18 mm; 160 points and steps of 0.05 ms, so that no mesh "
        "shows",
    ),
    (
        "does not give the origin; an arm based at it could not reach three targets",
        "the arm's base is at (200, 200) mm",
    ),
    (
        "does not give lengths of the links, joint limits, frame rate, resolution",
        "250, 200 and 135 mm; conf/arm and conf/camera (200 frames/s, 640 × 640)",
    ),
    (
        "does not give the place and size of the wall",
        "30 × 300 mm around (620, 350) mm; the camera does not see it, and the string "
        "bounces off it",
    ),
    (
        Markup("does not give the candidates of an estimation, nor p<sub>max</sub>"),
        "2000, and 20 dilations of 2 px",
    ),
    ('"a fraction of 1 of the range" by which later motions differ', "a quarter"),
    (
        "does not state what happens if no slight change of the last motion hits",
        "after 100,000 of them, any motion is tried",
    ),
    ('"several" casts before it is a failure', "five"),
    (
        "Euler's method",
        "semi-implicit Euler; the explicit one is unstable in most of Table 3's ranges",
    ),
    (
        "continues after a hit, to show the shape of the second cast",
        ("a run ends with its first hit; a figure of two casts then has one panel"),
    ),
    ("Fig. 7 has string A at (500, 900), the text on Fig. 10 has (900, 500)", "both"),
    (
        "Table 4 has k_ph = 44.7 and initial c_h, c_ph outside Table 3's ranges",
        "Fig. 11 and Table 4 are run with ranges that contain them "
        "(conf/string/table_4.yaml), all others with Table 3's",
    ),
    (
        "states that c_h is found at its maximum, which is 0.67 in Table 3 and 0.10 "
        "to 0.19 in Table 4",
        "a value counts as at an end of its range in Table 3, widened as above",
    ),
    (
        "the same first motion for A, B and C",
        (
            "it depends on target and seed alone, so runs of one seed start with the "
            "same motion"
        ),
    ),
)


def paper_figures(record: PaperRecord) -> dict[str, PaperFigure]:
    """Draw all figures for which the study has data, by name."""

    def first_two(condition: str) -> list[tuple[str, int]]:
        return [(condition, number) for number in record.cast_numbers(condition)[:2]]

    def first_and_last(condition: str) -> list[tuple[str, int]]:
        numbers = record.cast_numbers(condition)
        return [(condition, number) for number in sorted({*numbers[:1], *numbers[-1:]})]

    one_motion = [
        cast for name in ONE_MOTION_EXPERIMENTS for cast in first_and_last(name)[-1:]
    ]
    with style.context(STYLE_SHEET):
        drawn = {
            "fig_07": string_shapes_figure(record, first_two("A_500_900")),
            "fig_08": string_shapes_figure(record, first_two("C_300_900")),
            "fig_09": string_shapes_figure(record, first_two("B_400_700")),
            "fig_10": hand_paths_figure(record, FIG_10_EXPERIMENTS),
            "fig_11": string_shapes_figure(record, one_motion),
            "table_4": table_4_figure(record, ONE_MOTION_EXPERIMENTS),
            "fig_12": string_shapes_figure(record, first_and_last("D_500_500")),
            "fig_13": string_shapes_figure(record, first_and_last("wall")),
            "fig_14": matching_figure(record, "wall"),
        }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def paper_page(record: PaperRecord, drawn: Mapping[str, PaperFigure]) -> str:
    """Render the page from a record and its figures."""
    with style.context(STYLE_SHEET):
        pictures = {
            name: svg_picture(one.figure, one.alt) for name, one in drawn.items()
        }
    seeds = record.tables["runs"]["seed"].nunique()
    page = Page(
        kind="paper",
        name=PAPER,
        heading=f"The paper's experiments, with {format_count(seeds, 'seed')} each",
        lead=_describe_runs(record, seeds),
        sections=[
            _hit_rate_section(record),
            _figures_section(record, pictures),
            _failures_section(record),
            _choices_section(),
            _numbers_section(record),
        ],
        origin=record.provenance,
        settings=record.settings,
    )
    return str(page)


def _describe_runs(record: PaperRecord, seeds: int) -> Markup:
    runs = record.tables["runs"]
    ended = f"Here {len(runs)} of {record.requested_runs} runs have ended"
    failed = int((runs["state"] == "failed").sum())
    failures = Markup("")
    if failed:
        failures = Markup(', of which <strong class="bad">{} failed</strong>').format(
            failed
        )
        failures += " and count as never hitting"
    few = ", and wide with so few seeds" if seeds < MIN_RUNS_FOR_RATE else ""
    return join_sentences(
        [
            "Every experiment of the paper in the virtual lab, compared with the "
            "paper's numbers. The paper shows one run of each.",
            Markup("{}{}.").format(ended, failures),
            f"Intervals are 95 %{few}.",
        ]
    )


def _hit_rate_section(record: PaperRecord) -> Section | Text:
    """Tabulate the share of runs that hit within one to five casts."""
    if not record.finished_experiments:
        return Text("No run has ended yet.", "missing")
    lead = (
        "Share of the runs in which the tip reached the target within one to five "
        "casts, with 95 % intervals (Clopper and Pearson). Median: number of casts "
        "until half of the runs had hit."
    )
    rows, within = [], []
    for condition in record.finished_experiments:
        needed = record.rows_of("needed", condition).iloc[0]
        median, paper = "never", "not stated"
        if needed["median"] <= MAX_MANIPULATIONS:
            median = f"{needed['median']:.0f}"
        if np.isfinite(needed["paper"]):
            paper = f"{needed['paper']:.0f}"
        rates = record.rows_of("rates", condition)
        within = [f"within {number}" for number in rates["within"]]
        percents = (100 * rates[["share", "low", "high"]]).to_numpy()
        shares = [
            f"{share:.0f} ({low:.0f} to {high:.0f}) %" for share, low, high in percents
        ]
        label = f"{EXPERIMENT_LABELS[condition]} (n = {rates['count'].iloc[0]})"
        rows.append([label, *number_cells([*shares, median, paper])])
    table = table_card(["experiment", *within, "median", "paper"], rows)
    return Section("Hit rates", [Text(lead), table])


def _figures_section(
    record: PaperRecord, pictures: Mapping[str, Picture]
) -> Section | None:
    """Show each figure with the results of the paper and of our runs."""
    shown = []
    for name, (title, conditions, paper) in FIGURE_TEXTS.items():
        if name not in pictures:
            continue
        finished = [c for c in conditions if c in record.finished_experiments]
        sentences = [_describe_hits(record, condition) for condition in finished]
        here = sentence_markup(" ".join([*sentences, pictures[name].alt]))
        rows = [("paper", sentence_markup(paper)), ("here", here)]
        results = name_value_table(rows)
        shown.append(Figure(title, pictures[name], "", beside=results))
    if not shown:
        return None
    lead = (
        "The run shown is that with the lowest seed that needed the median number of "
        "casts. Earlier strings and arms are fainter; the last are those at the "
        "tip's closest approach to the target."
    )
    return Section("Figures and tables", [Text(lead), Container("grid", shown)])


def _describe_hits(record: PaperRecord, condition: str) -> str:
    """State the number of runs that hit, and compare it with the paper's one run."""
    table = record.rows_of("rates", condition).set_index("within")
    in_paper = record.rows_of("needed", condition)["paper"].iloc[0]
    is_stated = np.isfinite(in_paper)
    within = int(in_paper) if is_stated else int(table.index.max())
    rate = table.loc[within]
    count = f"{rate['right']:.0f} of {rate['count']:.0f} runs hit within {within}"
    comparison = ""
    if is_stated:
        agrees = rate["share"] >= 0.5
        comparison = ", as in the paper" if agrees else ", unlike the paper's one run"
    return f"{EXPERIMENT_LABELS[condition]}: {count}{comparison}."


def _failures_section(record: PaperRecord) -> Section | None:
    failed = record.tables["runs"].query("state == 'failed'").to_dict("records")
    if not failed:
        return None
    rows = [
        (EXPERIMENT_LABELS[run["condition"]], number_cell(run["seed"]), run["error"])
        for run in failed
    ]
    table = table_card(("experiment", "seed", "error"), rows)
    return Section("Failed runs", [table])


def _choices_section() -> Section:
    rows = [tuple(map(sentence_markup, texts)) for texts in OPEN_CHOICES]
    table = table_card(("the paper", "here"), rows)
    return Section("What the paper leaves open, and our choices", [table])


def _numbers_section(record: PaperRecord) -> Section:
    """List the numbers printed in the paper, with their places."""
    rows = []
    for row in record.tables["numbers"].to_dict("records"):
        is_symbol = row["of"][1:2] == "_" and len(row["of"]) < 5  # such as k_h
        subject = symbol_markup(row["of"]) if is_symbol else row["of"]
        value = number_cell(format_value(row["value"]))
        rows.append(
            (row["what"], subject, value, unit_markup(row["unit"]), row["place"])
        )
    table = TableView(("what", "of", "value", "unit", "place"), rows)
    return Section("The paper's numbers", [Details(f"{len(rows)} numbers", [table])])
