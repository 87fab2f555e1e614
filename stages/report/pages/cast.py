"""The page of casts, and of estimation alone: what came of each, and what was learnt of
the string.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report import formatting
from stringcast.stages.report.charts.camera import View, animation, overlay, whole_view
from stringcast.stages.report.charts.parameters import history
from stringcast.stages.report.charts.residual import (
    furthest,
    residual_curves,
    residual_map,
)
from stringcast.stages.report.charts.string import path, paths
from stringcast.stages.report.charts.time import joints, matching, progress
from stringcast.stages.report.formatting import (
    UNKNOWN,
    mm,
    ms,
    rate,
    sentence,
    significant,
    symbol,
    unit,
    within,
)
from stringcast.stages.report.page import (
    Card,
    Cell,
    Column,
    Details,
    Explore,
    Figure,
    Film,
    Grid,
    Key,
    Layer,
    Page,
    Part,
    Section,
    Small,
    Table,
    Text,
    Tile,
    Tiles,
    badge,
    bold,
    either,
    joined,
    link,
    number,
)
from stringcast.stages.report.records import Cast, RunRecord
from stringcast.stages.report.theme import MM_PER_M, ON_FRAMES, STYLE_SHEET

UNREAD = "No frame of this cast could be read, so there is nothing to compare the simulation with."
SILENT = "The arm reported no joint angles."
NOT_FILMED = Text("This cast has no camera frames.", "missing")
COLOURS = {
    "before": "simulated, before estimation",
    "after": "simulated, after",
    "measured": "measured",
    "target": "target",
}


def cast_page(record: RunRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE_SHEET):
        sections = [*summary(record), learnt(record), together(record)]
        part, far = whole_view(record) if record.casts else None, furthest(record)
        sections += [
            casting(record, n, cast, part, far)
            for n, cast in enumerate(record.casts, start=1)
            if part
        ]
    many = enumerate(record.casts, start=1) if len(record.casts) > 1 else ()
    judged = any(cast.valid for cast in record.casts)
    return str(
        Page(
            title=f"{record.name}: {record.sentence}",
            kicker=f"stringcast report · {record.name}",
            heading=record.sentence,
            lead=_aim(record),
            sections=sections,
            origin=record.provenance,
            settings=record.settings,
            tone=("good" if record.hit else "bad") if judged else "",
            marked=judged,
            nav=[(f"cast-{n}", joined([f"Cast {n}", ended(cast)])) for n, cast in many],
            following=record.next_commands,
            explored=True,
        )
    )


def _aim(record: RunRecord) -> str:
    """String and target in a sentence."""
    string, target = f"A string of {mm(record.model.string.length)}", record.target
    if not record.casts:
        return f"{string}."
    size = f"{round(target.w * MM_PER_M, 1):g} × {round(target.h * MM_PER_M, 1):g} mm"
    place = f"({target.x * MM_PER_M:.0f}, {target.y * MM_PER_M:.0f}) mm"
    return (
        f"{string}, and a target box of {size} around {place}, where x is to the right and y up from the world's "
        "origin."
    )


# --- all casts
# ------------------------------------------------------------------------------
def summary(record: RunRecord) -> list[Part]:
    """The summary: closest approach, agreement of the simulation, and a row for each
    cast.
    """
    if not record.casts:
        return []
    columns = [
        "cast",
        "tip in the box",
        "closest to centre",
        "at",
        "E before",
        "E after",
    ]
    columns += ["residual before", "residual after", "frames read"]
    rows = []
    for n, cast in enumerate(record.casts, start=1):
        closest = [number(mm(cast.verdict.distance)), number(ms(cast.verdict.t))]
        fitted: list[Cell | str] = [Cell("not estimated", "missing"), *[""] * 3]
        if cast.estimate is not None:
            fit = cast.estimate.fit.iloc[0]
            rates = [rate(fit["before"]), rate(fit["after"])]
            fitted = [
                number(one)
                for one in (*rates, mm(fit["rms_before"], 1), mm(fit["rms_after"], 1))
            ]
        frames = len(cast.points.readings)
        unread = sum(row["count"] for row in formatting.unread(cast.points.readings))
        read = number(f"{frames - unread} of {frames}")
        rows.append([link(f"#cast-{n}", n), ended(cast), *closest, *fitted, read])
    return [_tiles(record), Card("", [Table(columns, rows)])]


def _tiles(record: RunRecord) -> Tiles:
    known = [cast for cast in record.casts if np.isfinite(cast.verdict.distance)]
    best = min(
        known,
        key=lambda cast: (not cast.verdict.hit, cast.verdict.distance),
        default=None,
    )
    closest = "from the target's centre to the tip, at its closest"
    closest += " in the best cast" if len(record.casts) > 1 else ""
    unread = "No tip was read in any frame, so nobody can say how close it came."
    fit = record.estimates[-1].fit.iloc[0] if record.estimates else None
    rates = rms = "not estimated"
    if fit is not None:
        rates = f"{rate(fit['before'])} → {rate(fit['after'])}"
        rms = f"{mm(fit['rms_before'], 1)} → {mm(fit['rms_after'], 1)}"
    return Tiles(
        [
            Tile(mm(best.verdict.distance), closest) if best else Tile(UNKNOWN, unread),
            Tile(
                rates,
                "matching rate E of the last cast, before and after estimation (1 is perfect)",
            ),
            Tile(
                rms,
                "from the simulated to the measured centre-line, root mean square, before and after",
            ),
        ]
    )


def ended(cast: Cast) -> Markup:
    """Hit or missed; neither where the trial is not valid."""
    return (
        badge(cast.verdict.hit)
        if cast.valid
        else Markup('<span class="badge">not valid</span>')
    )


def together(record: RunRecord) -> Section | None:
    """Charts over the casts."""
    way = paths(record)
    if way is None:
        return None
    hands = "As the arm measured it; the last cast is the most marked. The square is the arm's base."
    rates = "Above, how close the tip came to the target's centre. Below, the matching rate E; before estimation it says "
    rates += "how well the simulation predicted the cast."
    parts = [
        Figure("Way of the hand", way, hands),
        Figure("Progress", progress(record), rates),
    ]
    return Section("From cast to cast", [Grid(parts)])


# --- what was learnt
# --------------------------------------------------------------------------
def learnt(record: RunRecord) -> Section:
    """Each parameter of the last estimate with its history; E over time where no cast
    shows it.
    """
    title = "What was learnt of the string"
    known: Known = []
    if record.estimates:
        rows = record.estimates[-1].parameters.set_index("name", drop=False)
        known = [
            (p, rows.loc[p.name])
            for p in record.model.parameters
            if p.name in rows.index
        ]
    if not known:
        return Section(title, [Text("Nothing was estimated in this run.", "missing")])

    # what is determined first; the rest is folded away
    certain = [one for one in known if one[1]["determined"]]
    rest = [one for one in known if not one[1]["determined"]]
    what = "which this data does not determine, or of which this method cannot say how sure they are"
    hidden = f"{len(rest)} {'other ' * bool(certain)}parameter{'s' * (len(rest) != 1)}, {what}"
    parts: list[Part] = [Text(sentence(record.estimates[-1].fit["sentence"].iloc[0]))]
    parts += (
        [Card("", [*_histories(record, certain), _learnt_table(certain)])]
        if certain
        else []
    )
    parts += (
        [Details(hidden, [*_histories(record, rest), _learnt_table(rest)])]
        if rest
        else []
    )

    # with casts, each shows the matching rate of its own estimation
    if not record.casts:
        none = "This estimation compared no masks, so there is no matching rate."
        titles = [
            f"Matching rate over time, estimation {n}"
            for n in range(1, len(record.estimates) + 1)
        ]
        given = zip(titles, record.estimates, strict=True)
        parts.append(
            Explore(
                [
                    Grid(
                        [
                            either(title, matching(one, title=title), none)
                            for title, one in given
                        ]
                    )
                ]
            )
        )
    return Section(title, parts)


HISTORY = (  # what is drawn of a parameter, and how
    ("best value; 0 is the start value", "var(--after)"),
    ("● determined", "none"),
    ("○ not determined by this data, or not known to be", "none"),
    ("range searched", "band"),
    ("95 % interval, where the method gives one", "bar"),
)
# parameters, each with its row of the last estimate
Known = list[tuple[Parameter, Any]]


def _histories(record: RunRecord, known: Known) -> list[Part]:
    """Estimation by estimation; nothing after a single one, of which the table says
    all.
    """
    if len(record.estimates) == 1:
        return []
    drawn = []
    for parameter, row in known:
        named = joined(
            [
                symbol(row["symbol"]) if row["symbol"] else "",
                bold(row["name"].replace("_", " ")),
            ]
        )
        caption = Markup("{} <span>[{}]</span>").format(named, unit(row["unit"]))
        drawn.append((caption, history(parameter, record.estimates)))
    return [Key(HISTORY), Small(drawn)]


def _learnt_table(known: Known) -> Table:
    """A row for each parameter."""
    columns = (
        "parameter",
        "",
        "value",
        "95 % interval",
        "range searched",
        "unit",
        "determined by this data",
    )
    rows = []
    for parameter, row in known:
        bounded = np.isfinite(row["low"]) and np.isfinite(row["high"])
        value, low, high = within(row["value"], row["low"], row["high"])
        determined = (
            "yes" if row["determined"] else "no" if np.isfinite(row["low"]) else UNKNOWN
        )
        cells = [
            Cell(row["name"].replace("_", " "), title=parameter.meaning),
            symbol(row["symbol"]),
            number(value),
            number(f"{low} to {high}") if bounded else Cell("none", "n missing"),
            number(f"{significant(row['minimum'])} to {significant(row['maximum'])}"),
            unit(row["unit"]),
            determined + ", at the end of its range" * bool(row["at_bound"]),
        ]
        rows.append(cells)
    return Table(columns, rows)


# --- one cast
# -----------------------------------------------------------------------------------
def casting(record: RunRecord, n: int, cast: Cast, part: View, far: float) -> Section:
    """Everything of one cast. far: end of the colour scale of all casts [m]."""
    unstable = [
        name
        for name, line in (("before", cast.before), ("after", cast.after))
        if not np.isfinite(line).all()
    ]
    undrawn = "The simulation with the parameters {} estimation did not stay finite; it is not drawn."
    layers = [
        Layer(name, ON_FRAMES[name], shown=name != "measured")
        for name in ("before", "after", "measured")
    ]
    own = (
        None
        if cast.estimate is None or cast.estimate is record.estimates[-1]
        else cast.estimate.fit.iloc[0]
    )

    # how many motions were tried is known from the record of the search alone
    tried: Part = Text("It was not recorded how many motions were tried.", "missing")
    if not cast.motion.attempts.empty:
        ranked = cast.motion.attempts.sort_values("count", ascending=False)
        rows = [
            (row["outcome"], number(row["count"])) for row in ranked.to_dict("records")
        ]
        tried = Table(("what became of them", "motions"), rows)

    parts = [
        Text(_told(cast)),
        # that of the last stands above all casts
        None if own is None else Text(sentence(own["sentence"])),
        *(Text(undrawn.format(name), "missing") for name in unstable),
        Explore(_compared(record, cast, part, far), layers),
        Grid(
            [
                Card("Motions tried until one was chosen", [tried]),
                _link_and_frames(cast),
            ]
        ),
    ]
    return Section(f"Cast {n}", parts, f"cast-{n}", ended(cast), "cast")


def _compared(record: RunRecord, cast: Cast, part: View, far: float) -> list[Part]:
    """Simulation and film side by side: where they were closest to the target, moving,
    over time, and their paths.
    """
    near: Part = Card("At the closest approach", [NOT_FILMED])
    if drawn := overlay(record, cast):
        caption = "The camera frame nearest in time. Dashed: the tip's way 30 ms before and after, ring: its closest "
        caption += "approach."
        key = Key([(words, ON_FRAMES[name]) for name, words in COLOURS.items()])
        near = Figure("At the closest approach", drawn, caption, beside=key)
    moving: Part = NOT_FILMED
    if film := animation(record, cast, part):
        span = (
            f"{len(film['t'])} camera frames from {film['t'][0]} to {film['t'][-1]} ms"
        )
        moving = Film(
            film, f"Animation of {span} with the measured and simulated strings"
        )
    where = "Where along the string and when, after estimation; gaps are frames that could not be read. The colours "
    where += "mean the same in all casts."
    away = Figure(
        "Distance of simulated and measured string",
        residual_map(record, cast, far),
        where,
        UNREAD,
    )

    unmatched = (
        "no masks were compared in this estimation"
        if cast.estimate
        else "nothing was estimated from this cast"
    )
    none = f"There is no matching rate: {unmatched}."
    agreed = [either("Matching rate over time", matching(cast.estimate, cast), none)]
    agreed += [either("Distance over time", residual_curves(record, cast), UNREAD)]

    # the joints together are as high as the hand's path beside them
    about = "As measured during the movement. Grey: the arm at the start (faint) and at the closest approach."
    paths = Figure("Paths of hand and tip", path(record, cast), about, SILENT)
    angles = (
        Column(joints(cast))
        if len(cast.trial.arm)
        else either("Joint angles", None, SILENT)
    )
    return [
        Grid([Column([near, away]), Card("Animation", [moving])]),
        Grid(agreed),
        Grid([paths, angles]),
    ]


def _told(cast: Cast) -> Markup:
    """How it went, in sentences."""
    verdict, plan = cast.verdict, cast.motion.outcome.iloc[0]
    if np.isfinite(verdict.distance):
        said = [
            f"The tip came within {mm(verdict.distance)} of the target's centre, at {ms(verdict.t, 1)} of a movement "
            f"of {ms(plan['duration'])}. The simulation expected it at {ms(plan['t_hit'])}."
        ]
        if np.isfinite(plan.get("chance", np.nan)):
            chances = "{:.2f} ({:.2f} to {:.2f})".format(
                *plan[["chance", "chance_low", "chance_high"]]
            )
            said.append(f"The predicted chance of hitting was {chances}.")
    else:
        why = (
            "no frame shows the string clearly enough"
            if len(cast.points.readings)
            else "there are no frames"
        )
        said = [f"The tip was not read in this cast: {why}."]
    if verdict.touched:
        said.append(
            f"The string lay in an obstacle in {verdict.touched} frame(s); nothing is learned from what it does from "
            "there on, and it is simulated as if nothing stood there."
        )
    return joined(said)


def _link_and_frames(cast: Cast) -> Card:
    """Whether arm and camera kept their budgets: how many commands and frames, how
    late, and what was not read.
    """
    how, unread = cast.trial.link.iloc[0], formatting.unread(cast.points.readings)
    invalid = Markup('<b class="bad">This trial is not valid:</b> {}.').format(
        how["reason"]
    )
    kept = Text("Arm and camera kept their budgets." if how["valid"] else invalid, "")

    late = ", ".join(
        ms(how[name], 2) for name in ("jitter_p50", "jitter_p99", "jitter_max")
    )
    rows = {
        "commands sent": how["ticks"],
        "late or lost": how["missed"],
        "lateness: median, 99 %, largest": late,
    }
    rows["frames filmed"] = len(cast.points.readings)
    if "frames_due" in how:  # cameras alone that tell when each frame was due
        frames_late = ", ".join(
            ms(how[f"frame_{name}"], 2)
            for name in ("jitter_p50", "jitter_p99", "jitter_max")
        )
        rows |= {
            "frames due, and of those dropped": f"{how['frames_due']}, {how['frames_dropped']}",
            "frames given twice, and late": f"{how['frames_repeated']}, {how['frames_late']}",
            "frames a second": f"{how['fps']:.2f}",
            "lateness of frames: median, 99 %, largest": frames_late,
        }
    rows["frames not read"] = sum(row["count"] for row in unread)
    parts: list[Part] = [
        kept,
        Table((), [(name, number(value)) for name, value in rows.items()], named=True),
    ]

    if how.get("remarks"):
        parts.append(Text(f"Not made sure of: {how['remarks']}.", ""))
    if unread:
        reasons = [(row["reason"], number(row["count"]), row["when"]) for row in unread]
        parts.append(Table(("why not", "frames", "when [ms]"), reasons))
    return Card("Link and frames", parts)
