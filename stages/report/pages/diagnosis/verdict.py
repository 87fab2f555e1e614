"""What came out: tiles, trials that were rejected, causes and what else it may be, and
the error budget.
"""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from stringcast.stages.report.charts.parameters import cause
from stringcast.stages.report.formatting import (
    enumerated,
    gain,
    mm,
    percent,
    plain,
    quantity,
)
from stringcast.stages.report.page import (
    Card,
    Figure,
    Grid,
    Part,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    bold,
    link,
    number,
)
from stringcast.stages.report.pages.diagnosis.prediction import predicted_worse
from stringcast.stages.report.records import DiagnosisRecord

RARE = 0.01  # probability up to which an alternative is not worth a line
LIKELY = 0.5  # probability from which a cause is more likely than not


def tiles(record: DiagnosisRecord) -> Tiles:
    """Trials looked at, and how well the models predict."""
    trials, total = record.document["trials"], record.document["gain"]
    used, outliers = (
        len(trials["used"]),
        trials.get("points_left_out", {}).get("outliers", 0),
    )
    looked = f"trial{'s' * (used != 1)} looked at"
    looked += f", {len(trials['rejected'])} rejected" if trials["rejected"] else ""
    looked += (
        f", {outliers} outlying point{'s' * (outliers != 1)} left out"
        if outliers
        else ""
    )
    first = Tile(
        str(used), f"{looked}, of a string of {mm(record.model.string.length)}"
    )
    if not total["held_out_trials"]:
        return Tiles(
            [
                first,
                Tile(
                    "not known",
                    "how well it predicts: no trial could be left out of the fit",
                ),
            ]
        )
    which = "base and extended model" if len(record.models) > 1 else "base model"
    names = [row["trial"] for row in predicted_worse(record)]
    but = f" (worse for {enumerated(names)}: see below)" if names else ""
    rms = f"from simulated to measured string on trials left out of the fit, root mean square, {which}{but}; noise alone "
    rms += f"leaves {mm(total['rms_m']['noise_floor'], 1)}"
    tip = "the same at the tip, or the outermost point measured"
    values = [
        " → ".join(mm(total[of][side], 1) for side in record.models)
        for of in ("rms_m", "tip_rms_m")
    ]
    return Tiles([first, Tile(values[0], rms), Tile(values[1], tip)])


def rejected(record: DiagnosisRecord) -> Part | None:
    """Trials that could not be used, and why."""
    trials = record.document["trials"]["rejected"]
    return (
        Card(
            "Trials that could not be used",
            [Table((), list(trials.items()), named=True)],
        )
        if trials
        else None
    )


def causes(record: DiagnosisRecord) -> Section:
    """The causes, with their parameters, laws and references; what looks alike; what
    else it may be.
    """
    cards = []
    for name, rows in record.diagnosis.causes.groupby("effect", sort=False):
        likely, said = rows["probability"].iloc[0], str(rows["sentence"].iloc[0])
        told: list[Part] = [Text(f"{said[:1].upper()}{said[1:]}.", "")]
        found = rows[rows["parameter"] != ""]
        if len(found):
            table = [
                (row["meaning"], *map(number, quantity(row)))
                for row in found.to_dict("records")
            ]
            told.append(Table(("", "value", "95 % interval"), table))
        if effect := record.library.get(str(name)):
            values = {
                p.parameter.rpartition(".")[2]: p.value for p in found.itertuples()
            }
            caption = f"Reference: {effect.reference}." if effect.reference else ""
            told.append(Figure("", cause(effect, values), caption))
        sure, mark = (
            "good" if likely > LIKELY else "",
            Markup('{} <span class="badge {}">{}</span>'),
        )
        cards.append(Card(mark.format(plain(str(name)), sure, percent(likely)), told))

    others = [a for a in record.document["alternatives"] if a["probability"] > RARE]
    more = [
        (plain(other["effect"]), number(percent(other["probability"])))
        for other in others
    ]
    rest = (
        Table((), more, named=True)
        if more
        else Text("Nothing else has more than 1 %.", "missing")
    )
    parts: list[Part] = [*map(Text, _verdict(record))]
    parts += [Grid(cards)] if cards else []
    return Section(
        "Causes" if cards else "No cause is named",
        [*parts, Card("What else it may be", [rest])],
    )


def _verdict(record: DiagnosisRecord) -> list[Markup | str]:
    """The meaning of the verdict, in sentences."""
    verdict = record.document["verdict"]
    said: list[Markup | str] = []
    for group in record.document["indistinguishable"]:
        compared = record.diagnosis.likeness
        pairs = compared[compared["effect"].isin(group) & compared["other"].isin(group)]
        # empty where it was not asked
        least = f" (correlation {pairs['cosine'].min():.3f})" if len(pairs) else ""
        alike = bold(
            f"These look alike here: {enumerated([plain(name) for name in group])}{least}."
        )
        said.append(
            alike
            + " Each explains what was measured about as well as the others, so this data does not say which it "
            "is. Their probabilities below are shared among them."
        )
    if verdict == "none":
        said.append(
            "What is left is noise and less than is tolerated. No effect of the library is evident."
        )
    if verdict == "unknown":
        said.append(
            Markup(
                "More is left at the tip than is tolerated, and no effects of the library remove enough of it. It is "
                "shown under {}."
            ).format(link("#left", "What is left"))
        )
    if record.document.get("interrupted"):
        said.append(
            "Nothing is named before all was asked. What was known by then is shown below."
        )
    elif verdict == "insufficient":
        said.append(
            "Naming a cause takes more data than this. What was seen is shown below."
        )
    return said


def budget(record: DiagnosisRecord) -> Section | None:
    """The error budget at the tip, where the diagnosis has one."""
    sources, left = (
        record.document.get("budget"),
        record.document["unexplained"].get("tip_rms_m"),
    )
    if not sources:
        return None
    lead = (
        "How far each source moves the string's tip, root mean square over the trials."
    )
    if left:
        low, most, high = (mm(left[end], 1) for end in ("low", "value", "high"))
        tolerated = mm(record.document["unexplained"]["tolerance_m"], 1)
        lead += f" What nothing explains is {most} ({low} to {high}, 95 %); up to {tolerated} are tolerated."
    rows = [
        (
            plain(one["source"]),
            number(mm(one["tip_rms_m"], 2)),
            number(gain(one.get("log_evidence", np.nan), "")),
        )
        for one in sources
    ]
    table = Table(("source", "at the tip", "evidence for it [log]"), rows)
    return Section("Error budget", [Text(lead), Card("", [table])])
