"""The page of the paper's experiments: its tables and figures with ours beside them,
and whether the two agree.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup
from matplotlib import style
from matplotlib.figure import Figure as Drawing

from stringcast.stages.report.charts.parameters import table_4
from stringcast.stages.report.charts.string import shapes, trajectories
from stringcast.stages.report.charts.time import fig_14
from stringcast.stages.report.formatting import sentence, significant, symbol, unit
from stringcast.stages.report.page import (
    Card,
    Details,
    Figure,
    Grid,
    Page,
    Section,
    Table,
    Text,
    joined,
    number,
)
from stringcast.stages.report.records import EXPERIMENT_LABELS, PaperFigure, PaperRecord
from stringcast.stages.report.theme import LIGHT_COLOURS, STYLE_SHEET, Picture, vector

PAPER = "Tabata, Seki, Tsuji and Hitamitsu, Casting manipulation of unknown string by robot arm (IROS 2021)"
ONE_MOTION = ("one_motion_A", "one_motion_B", "one_motion_C")
TARGETS = ("A_300_900", "A_400_700", "A_900_500")
# runs of an experiment below which a share is hardly a rate: its 95 % interval is 45
# points wide at one half
FEW = 20
NEVER = 99  # manipulations, more than any run makes

# What stands above each figure, the experiments it is of, and what the paper says about
# them.
SECTIONS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "fig_07": (
        "Fig. 7: string A to (500, 900)",
        ("A_500_900",),
        "The first manipulation hits, with another shape.",
    ),
    "fig_08": (
        "Fig. 8: string C to (300, 900)",
        ("C_300_900",),
        "The first manipulation hits, with another shape.",
    ),
    "fig_09": (
        "Fig. 9: string B to (400, 700)",
        ("B_400_700",),
        "The first manipulation misses, the second hits.",
    ),
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
    "fig_12": (
        "Fig. 12: string D, n = 25",
        ("D_500_500",),
        "It hits; in which manipulation is not said.",
    ),
    "fig_13": (
        "Fig. 13: around a wall",
        ("wall",),
        "It hits in the fifth manipulation.",
    ),
    "fig_14": (
        "Fig. 14: E over time, around the wall",
        (),
        "E of the fourth manipulation is higher than that of the first around the moment of the hit.",
    ),
}
# Where the paper is silent, and what we chose.
SILENT = (
    (
        "does not give the strings' properties: B is harder than A, C softer, D the softest",
        "strings of the virtual lab (conf/specimen) that bend under their own weight over 131, 77, 45 and 18 mm; 40 "
        "points, another integrator and step than the model's, so that the lab can surprise it",
    ),
    (
        "does not say where the origin is; three targets would be out of reach of an arm based at it",
        "the arm's base is at (200, 200) mm",
    ),
    (
        "does not give lengths of the links, joint limits, frame rate, resolution",
        "250, 200 and 135 mm; conf/arm and conf/camera (200 frames a second, 640 × 640)",
    ),
    (
        "does not give the place and size of the wall",
        "30 × 300 mm around (620, 350) mm; it is not filmed, and the string bounces off it",
    ),
    (
        Markup(
            "does not give how many candidates an estimation tries, nor p<sub>max</sub>"
        ),
        "2000, and 20 dilations of 2 px",
    ),
    ('"a fraction of 1 of the range" by which later motions differ', "a quarter"),
    (
        "does not say what is done where no slight change of the last motion hits",
        "after 100,000 of them, any motion is tried",
    ),
    ('"several" manipulations before it is a failure', "five"),
    (
        "Euler's method",
        "semi-implicit Euler; the explicit one is unstable in most of Table 3's ranges",
    ),
    (
        "goes on after a hit, to show the shape of the second manipulation",
        "a run ends with its first hit; a figure of two manipulations has one panel where the first hit",
    ),
    ("Fig. 7 has string A at (500, 900), the text on Fig. 10 has (900, 500)", "both"),
    (
        "Table 4 has k_ph = 44.7 and initial c_h, c_ph outside Table 3's ranges",
        "Fig. 11 and Table 4 are run with ranges that hold them (conf/string/table_4.yaml), all others with Table 3's",
    ),
    (
        "says that c_h is found at its maximum, which is 0.67 in Table 3 and 0.10 to 0.19 in Table 4",
        "whether a value lies at an end of its range is told by Table 3, widened as above",
    ),
    (
        "the same first motion for A, B and C",
        "it depends on target and seed alone, so runs of one seed begin with the same motion",
    ),
)


def paper_page(record: PaperRecord, drawn: Mapping[str, PaperFigure]) -> str:
    """The page as text; the same record gives the same page. drawn: its `figures`."""
    runs = record.tables["runs"]
    seeds = runs["seed"].nunique()
    title = f"The paper's experiments, {seeds} time{'s' * (seeds != 1)} each"
    with style.context(STYLE_SHEET):
        pictures = {name: vector(one.figure, one.alt) for name, one in drawn.items()}
    return str(
        Page(
            title=title,
            kicker=f"stringcast · {PAPER}",
            heading=title,
            lead=_lead(record, seeds),
            sections=[
                hits(record, pictures),
                figures_and_tables(record, pictures),
                *further(record),
            ],
            origin=record.provenance,
            settings=record.settings,
        )
    )


def _lead(record: PaperRecord, seeds: int) -> Markup:
    """How many runs there are, and what that is worth."""
    runs = record.tables["runs"]
    bad = int((runs["state"] == "failed").sum())
    failed = ', of which <strong class="bad">{} failed</strong> and count as never having hit'
    few = (
        ", and with so few seeds they are wide: nothing here is a rate yet"
        if seeds < FEW
        else ""
    )
    return joined(
        [
            "Every experiment of the paper on the virtual lab, with the paper's numbers beside ours. The paper shows "
            "one run of each.",
            Markup(
                "Here each was begun with {} seed{}: {} of {} runs have ended{}."
            ).format(
                seeds,
                "s" * (seeds != 1),
                len(runs),
                record.requested_runs,
                Markup(failed).format(bad) if bad else "",
            ),
            f"Intervals are of 95 %{few}.",
        ]
    )


# --- how often it hits
def hits(record: PaperRecord, pictures: Mapping[str, Picture]) -> Section | Text:
    """Share of the runs that hit within so many manipulations."""
    if "hit_rates" not in pictures:
        return Text("No run has ended yet.", "missing")
    about = "Share of the runs in which the tip reached the target within one, two, three and five manipulations. "
    about += "Bars: 95 % intervals (Clopper and Pearson). Median: manipulations that half of the runs needed at most."
    within = record.of("rates", record.conditions[0])["within"]
    columns = [
        "experiment",
        *(f"within {n}" for n, _ in enumerate(within, 1)),
        "median",
        "paper",
    ]
    rows = []
    for condition in record.conditions:
        needed = record.of("needed", condition).iloc[0]
        median = "never" if needed["median"] > NEVER else f"{needed['median']:.0f}"
        paper = f"{needed['paper']:.0f}" if np.isfinite(needed["paper"]) else "not said"
        found = record.of("rates", condition)
        ends = zip(
            *(100 * found[name] for name in ("share", "low", "high")), strict=True
        )
        shares = [
            f"{share:.0f} ({low:.0f} to {high:.0f}) %" for share, low, high in ends
        ]
        rows.append(
            [
                EXPERIMENT_LABELS[condition].replace(" ", "\u00a0"),
                *map(number, (*shares, median, paper)),
            ]
        )
    return Section(
        "How often it hits",
        [
            Card("", [Figure("", pictures["hit_rates"], about)]),
            Card("", [Table(columns, rows)]),
        ],
    )


# --- figures and tables
def figures_and_tables(
    record: PaperRecord, pictures: Mapping[str, Picture]
) -> Section | None:
    """Each figure with what the paper says and what came out here."""
    shown = []
    for name, (title, conditions, paper) in SECTIONS.items():
        if name in pictures:
            here = [
                outcome(record, condition)
                for condition in conditions
                if condition in record.conditions
            ]
            said = sentence(" ".join([*here, pictures[name].alt]))
            beside = Table((), [("paper", sentence(paper)), ("here", said)], named=True)
            shown.append(Figure(title, pictures[name], "", beside=beside))
    lead = "Drawn is the run with the lowest seed that needed the median number of manipulations: neither the "
    lead += "luckiest nor the unluckiest. Strings and arm are fainter the earlier they are; the last are at the tip's "
    lead += "closest approach to the target."
    return Section("Figures and tables", [Text(lead), Grid(shown)]) if shown else None


def outcome(record: PaperRecord, condition: str) -> str:
    """The number of runs that hit, and whether the paper's one run did likewise."""
    table = record.of("rates", condition).set_index("within")
    needed = record.of("needed", condition).iloc[0]
    within = (
        int(needed["paper"])
        if needed["paper"] == needed["paper"]
        else int(table.index.max())
    )
    one = table.loc[within]
    said = f"{EXPERIMENT_LABELS[condition]}: {one['right']:.0f} of {one['count']:.0f} runs hit within {within}"
    if needed["paper"] != needed["paper"]:
        return f"{said}."
    alike = "as in the paper" if one["share"] >= 0.5 else "unlike the paper's one run"
    return f"{said}, {alike}."


# --- what else
def further(record: PaperRecord) -> list[Section]:
    """Runs that failed, and why; the values that the paper leaves open; and the numbers
    that it prints, with their places.
    """
    runs = record.tables["runs"].query("state == 'failed'").to_dict("records")
    failed = [
        (EXPERIMENT_LABELS[run["condition"]], number(run["seed"]), run["error"])
        for run in runs
    ]
    table = Table(("experiment", "seed", "error"), failed)
    sections = [Section("Failed runs", [Card("", [table])])] if failed else []

    rows = [
        tuple(said if isinstance(said, Markup) else sentence(said) for said in row)
        for row in SILENT
    ]
    chosen = Card("", [Table(("the paper", "here"), rows)])
    sections.append(Section("Where the paper is silent, and what we chose", [chosen]))

    printed = []
    for n in record.tables["numbers"].to_dict("records"):
        # such as k_h, or words
        of = symbol(n["of"]) if n["of"][1:2] == "_" and len(n["of"]) < 5 else n["of"]
        printed.append(
            (
                n["what"],
                of,
                number(significant(n["value"])),
                unit(n["unit"]),
                n["place"],
            )
        )
    table = Table(("what", "of", "value", "unit", "place"), printed)
    folded = Details(f"{len(printed)} numbers, with their places", [table])
    return [*sections, Section("The paper's numbers", [folded])]


# --- the paper's figures again, from the study's tables alone
def paper_figures(record: PaperRecord) -> dict[str, PaperFigure]:
    """Every figure of which the study has data, by name."""
    with style.context(STYLE_SHEET):
        drawn = {
            "hit_rates": rates(record),
            "fig_07": shapes(record, first_two(record, "A_500_900")),
            "fig_08": shapes(record, first_two(record, "C_300_900")),
            "fig_09": shapes(record, first_two(record, "B_400_700")),
            "fig_10": trajectories(record, TARGETS),
            "fig_11": shapes(
                record,
                [
                    (name, record.casts(name)[-1])
                    for name in ONE_MOTION
                    if record.casts(name)
                ],
            ),
            "table_4": table_4(record, ONE_MOTION),
            "fig_12": shapes(record, ends(record, "D_500_500")),
            "fig_13": shapes(record, ends(record, "wall")),
            "fig_14": fig_14(record, "wall"),
        }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def first_two(record: PaperRecord, condition: str) -> list[tuple[str, int]]:
    """The first and second cast of an experiment, as far as there are any."""
    return [(condition, number) for number in record.casts(condition)[:2]]


def ends(record: PaperRecord, condition: str) -> list[tuple[str, int]]:
    """The first and the last cast of an experiment."""
    made = record.casts(condition)
    return [(condition, number) for number in dict.fromkeys(made[:1] + made[-1:])]


SHOWN = {
    1: ("before", "o"),
    2: ("after", "s"),
    3: ("measured", "D"),
    5: ("target", "^"),
}


def rates(record: PaperRecord) -> PaperFigure | None:
    """A row an experiment; bars are 95 % intervals."""
    if not record.conditions:
        return None
    figure = Drawing(figsize=(5.4, 1.1 + 0.42 * len(record.conditions)))
    axes = figure.subplots()
    for row, condition in enumerate(record.conditions):
        table = record.of("rates", condition).set_index("within")
        for step, (within, (colour, marker)) in enumerate(SHOWN.items()):
            if within in table.index:
                one = table.loc[within]
                place = row + 0.18 * (step - 1.5)
                axes.hlines(
                    place,
                    one["low"],
                    one["high"],
                    color=LIGHT_COLOURS[colour],
                    lw=2.5,
                    alpha=0.3,
                )
                label = f"within {within}" if row == 0 else None
                axes.plot(
                    one["share"],
                    place,
                    marker,
                    color=LIGHT_COLOURS[colour],
                    ms=4.5,
                    ls="none",
                    label=label,
                )
    labels = [
        f"{EXPERIMENT_LABELS[name]}  (n = {record.of('rates', name)['count'].iloc[0]})"
        for name in record.conditions
    ]
    axes.set_yticks(range(len(labels)), labels)
    axes.set(
        xlim=(-0.02, 1.02),
        ylim=(len(labels) - 0.5, -0.5),
        xlabel="share of runs that hit, with 95 % interval",
    )
    axes.set_xticks(
        np.linspace(0, 1, 6), ["0", "20 %", "40 %", "60 %", "80 %", "100 %"]
    )
    figure.legend(
        *axes.get_legend_handles_labels(),
        loc="outside upper left",
        ncols=4,
        title="manipulations",
    )
    whole = record.tables["rates"]
    most = whole[whole["within"] == whole["within"].max()].set_index("condition")
    said = [
        f"{EXPERIMENT_LABELS[name]} {most.loc[name, 'right']} of {most.loc[name, 'count']}"
        for name in record.conditions
    ]
    return PaperFigure(
        figure,
        f"Runs that hit within {whole['within'].max()} manipulations: {', '.join(said)}.",
    )
