"""The page of a diagnosis: the verdict, its evidence and the gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib import style

from stringcast.stages.model.library import library
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.report.charts.parameters import cause, likeness, screenings
from stringcast.stages.report.charts.residual import curves, likelier, maps, predicted, size, tip_curves
from stringcast.stages.report.charts.string import film, last, proposed, worst
from stringcast.stages.report.charts.time import latent, missing
from stringcast.stages.report.page import (
    Card,
    Cell,
    Details,
    Explore,
    Figure,
    Film,
    Grid,
    Jump,
    Layer,
    Page,
    Part,
    Section,
    Side,
    Table,
    Text,
    Tile,
    Tiles,
    bold,
    code,
    joined,
    link,
    named,
    number,
)
from stringcast.stages.report.records import DiagnosisRecord, Facts, away
from stringcast.stages.report.theme import MM, STYLE
from stringcast.stages.report.words import (
    UNKNOWN,
    enumerated,
    gain,
    headline,
    interval,
    mm,
    ms,
    percent,
    plain,
    quantity,
    rate,
    significant,
    symbol,
    unit,
    within,
)

FEW = 12  # theories shown at once; the others are folded
WORSE = 1.2  # times the residual without causes: that much more with them is worth a sentence
RARE = 0.01  # probability up to which an alternative is not worth a line
LIKELY = 0.5  # probability from which a cause is more likely than not
TONES = {"none": "good", "unknown": "bad", "insufficient": "bad"}
NOTHING = "Nothing was measured that could be compared."


def stage_page(facts: Facts) -> str:
    """The page of a diagnosis as a stage made it."""
    given = (facts.name, facts.made, facts.model, library(), facts.settings, facts.origin, facts.following)
    return diagnosis_page(DiagnosisRecord(*given))


def diagnosis_page(record: DiagnosisRecord) -> str:
    """The page as text; the same record gives the same page."""
    with style.context(STYLE):
        sections = [tiles(record), rejected(record), causes(record), budget(record), wrong(record), trials(record)]
        sections += [found(record), gained(record), left(record), string(record)]
    return str(
        Page(
            title=f"{record.name}: {headline(record.document)}",
            kicker=f"stringcast diagnosis · {record.name}",
            heading=headline(record.document),
            lead=record.diagnosis.sentence,
            sections=sections,
            origin=record.origin,
            settings=record.settings,
            tone=TONES.get(record.document["verdict"], ""),
            following=record.following,
            explored=bool(record.trials or record.following),
        )
    )


# --- what came out ----------------------------------------------------------------------------
def tiles(record: DiagnosisRecord) -> Tiles:
    """Trials looked at, and how well the models predict."""
    trials, total = record.document["trials"], record.document["gain"]
    used, outliers = len(trials["used"]), trials.get("points_left_out", {}).get("outliers", 0)
    looked = f"trial{'s' * (used != 1)} looked at"
    looked += f", {len(trials['rejected'])} rejected" if trials["rejected"] else ""
    looked += f", {outliers} outlying point{'s' * (outliers != 1)} left out" if outliers else ""
    first = Tile(str(used), f"{looked}, of a string of {mm(record.model.string.length)}")
    if not total["held_out_trials"]:
        return Tiles([first, Tile("not known", "how well it predicts: no trial could be left out of the fit")])
    which = "base and extended model" if len(record.models) > 1 else "base model"
    names = [row["trial"] for row in _worse(record)]
    but = f" (worse for {enumerated(names)}: see below)" if names else ""
    rms = (
        f"from simulated to measured string on trials left out of the fit, root mean square, {which}{but}; noise alone "
    )
    rms += f"leaves {mm(total['rms_m']['noise_floor'], 1)}"
    tip = "the same at the tip, or the outermost point measured"
    values = [" → ".join(mm(total[of][side], 1) for side in record.models) for of in ("rms_m", "tip_rms_m")]
    return Tiles([first, Tile(values[0], rms), Tile(values[1], tip)])


def rejected(record: DiagnosisRecord) -> Part | None:
    """Trials that could not be used, and why."""
    trials = record.document["trials"]["rejected"]
    return Card("Trials that could not be used", [Table((), list(trials.items()), named=True)]) if trials else None


def causes(record: DiagnosisRecord) -> Section:
    """The causes, with their parameters and laws; what looks alike; what else it may be."""
    by_name = record.diagnosis.causes.groupby("effect", sort=False)
    cards = [_cause(record, str(name), rows) for name, rows in by_name]
    others = [a for a in record.document["alternatives"] if a["probability"] > RARE]
    rows = [(plain(other["effect"]), number(percent(other["probability"]))) for other in others]
    rest = Table((), rows, named=True) if rows else Text("Nothing else has more than 1 %.", "missing")
    parts: list[Part] = [*map(Text, _verdict(record))]
    parts += [Grid(cards)] if cards else []
    return Section("Causes" if cards else "No cause is named", [*parts, Card("What else it may be", [rest])])


def _verdict(record: DiagnosisRecord) -> list[Markup | str]:
    """The meaning of the verdict, in sentences."""
    verdict = record.document["verdict"]
    said: list[Markup | str] = []
    for group in record.document["indistinguishable"]:
        alike = bold(
            f"These look alike here: {enumerated([plain(name) for name in group])}{_correlated(record, group)}."
        )
        said.append(
            alike + " Each explains what was measured about as well as the others, so this data does not say which it "
            "is. Their probabilities below are shared among them."
        )
    if verdict == "none":
        said.append("What is left is noise and less than is tolerated. No effect of the library is evident.")
    if verdict == "unknown":
        said.append(
            Markup(
                "More is left at the tip than is tolerated, and no effects of the library remove enough of it. It is "
                "shown under {}."
            ).format(link("#left", "What is left"))
        )
    if verdict == "insufficient":
        said.append("Naming a cause takes more data than this. What was seen is shown below.")
    return said


def _correlated(record: DiagnosisRecord, group: Sequence[str]) -> str:
    """The least correlation between what effects of a group do, in words; empty where it was not asked."""
    table = record.diagnosis.likeness
    pairs = table[table["effect"].isin(group) & table["other"].isin(group)]
    return f" (correlation {pairs['cosine'].min():.3f})" if len(pairs) else ""


def _cause(record: DiagnosisRecord, name: str, rows: pd.DataFrame) -> Card:
    """A cause with its parameters, its law and where it comes from."""
    found = rows[rows["parameter"] != ""]
    likely, said, effect = rows["probability"].iloc[0], str(rows["sentence"].iloc[0]), record.library.get(name)
    parts: list[Part] = [Text(f"{said[:1].upper()}{said[1:]}.", "")]
    if len(found):
        table = [(row["meaning"], number(quantity(row)), number(interval(row))) for row in found.to_dict("records")]
        parts.append(Table(("", "value", "95 % interval"), table))
    if effect:
        values = {p.parameter.rpartition(".")[2]: p.value for p in found.itertuples()}
        caption = f"Reference: {effect.reference}." if effect.reference else ""
        parts.append(Figure("", cause(effect, values), caption))
    mark = Markup('{} <span class="badge {}">{}</span>')
    return Card(mark.format(plain(name), "good" if likely > LIKELY else "", percent(likely)), parts)


# --- the budget
def budget(record: DiagnosisRecord) -> Section | None:
    """The error budget at the tip, where the diagnosis has one."""
    sources, left = record.document.get("budget"), record.document["unexplained"].get("tip_rms_m")
    if not sources:
        return None
    lead = "How far each source moves the string's tip, root mean square over the trials."
    if left:
        low, most, high = (mm(left[end], 1) for end in ("low", "value", "high"))
        tolerated = mm(record.document["unexplained"]["tolerance_m"], 1)
        lead += f" What nothing explains is {most} ({low} to {high}, 95 %); up to {tolerated} are tolerated."
    rows = [
        (plain(one["source"]), number(mm(one["tip_rms_m"], 2)), number(gain(one.get("log_evidence", np.nan), "")))
        for one in sources
    ]
    table = Table(("source", "at the tip", "evidence for it [log]"), rows)
    return Section("Error budget", [Text(lead), Card("", [table])])


# --- what the simulation gets wrong -------------------------------------------------------------
def wrong(record: DiagnosisRecord) -> Section:
    """Residuals over arc length and time, trial by trial; the strings where they are worst; the way of the tip."""
    about = (
        "Arc length s from the grasp, over time; one row for each trial. Orange: the measured string lies to the left "
        "of the simulated one, or further towards the tip; blue: the other way. Faint is noise; a patch of colour is a "
        "mistake of the model, or of its arithmetic where the string moves so violently that small errors grow. Grey: "
        "not measured. The colours mean the same in all maps."
    )
    much = "Dots beyond the bar are more than noise and the simulation's own error account for."
    where = [Figure(f"Residual maps: {side} model", maps(record, side), about, NOTHING) for side in record.models]
    parts: list[Part] = [
        *map(Text, _compared(record)),
        Grid([*where, Figure("Error by trial", size(record), much, NOTHING)]),
    ]
    return Section("What the simulation gets wrong", parts)


def trials(record: DiagnosisRecord) -> Section | None:
    """Trials side by side, to play: the string, and how far from it the models are; all on one clock."""
    if not record.trials:
        return None
    layers = [Layer("base", "before"), Layer("extended", "after"), Layer("measured", "measured", dots=True)]
    shown = [layer for layer in layers if layer.name in (*record.models, "measured")]
    lead = "Point at a curve, and every trial shows its string at that time; drag to zoom, double click for the "
    lead += "whole. With the keyboard: arrows, + and −, 0. Faint lines are the ways of the tips. Each begins in the "
    lead += "frame that the base model gets most wrong."
    cards = Side([_trial(record, trial, table) for trial, table in record.trials.items()])
    return Section("Trials side by side", [Text(lead), Explore([cards], shown, times=True)], "trials")


def _trial(record: DiagnosisRecord, trial: str, table: pd.DataFrame) -> Card:
    """The string of a trial, to play, and its curves."""
    frame = worst(table)
    moment = float(frame["t"].iloc[0])
    off = ", ".join(f"{m} {mm(float(np.sqrt(np.mean(away(frame, m) ** 2))), 1)}" for m in record.models)
    played = Film(film(record, table), f"The string in trial {trial} over time, measured and simulated.")
    jump = Jump(moment * MM, f"Most wrong at {ms(moment)}: {off} off")
    charts = [curves(record, trial), tip_curves(record, trial, last(table)), latent(record, trial)]
    return Card(trial, [played, jump, *(chart for chart in charts if chart)])


def _compared(record: DiagnosisRecord) -> list[str]:
    """Which models and trials are drawn."""
    document, extended = record.document, len(record.models) > 1
    lead = "The base model is the configured one with its parameters fitted to these trials, so what it gets wrong no "
    lead += "choice of parameters mends."
    if extended:
        added = enumerated([plain(name) for name in record.extension["effects"]])
        lead += f" The extended model adds {added} and is fitted to the same trials."
    if len(record.trials) < len(document["trials"]["used"]):
        lead += (
            f" Drawn are the {len(record.trials)} trials of {len(document['trials']['used'])} that the base model gets "
        )
        lead += "most wrong."
    if document["verdict"] != "effect" or extended or record.diagnosis.causes.empty:
        return [lead]
    points = record.extension["string"]["points"], record.model.string.points
    return [
        lead,
        f"The maps are those of {points[0]} mass points in place of {points[1]}; with these, the misfit is gone.",
    ]


# --- how it was found -----------------------------------------------------------------------------
def found(record: DiagnosisRecord) -> Section:
    """The section of promised effects, look-alikes, and every hypothesis that was fitted."""
    promised, theories = screenings(record), _theories(record.diagnosis.theories)
    first = "Gain of the log-likelihood to first order, with the string's parameters refitted. Blue: named as a cause."
    drawn = [Figure(f"Predicted gains{f' beside {at}' if at else ' of all effects'}", p, first) for at, p in promised]
    alike = likeness(record)
    if alike:
        about = "1: the two do the same to this data and cannot be told apart; 0: nothing in common."
        drawn.append(Figure("Confounded effects", alike, about))
    more = theories[FEW:]
    tried: list[Part] = [_theories_table(theories[:FEW])]
    tried += [Details(f"{len(more)} more", [_theories_table(more)])] if more else []
    return Section(
        "How it was found",
        [Text(_search(record)), Grid(drawn), Card("Hypotheses fitted", [*tried, Text(EVIDENCE, "caption")])],
    )


EVIDENCE = (
    "Log evidence: logarithm of the Bayes factor over the base model, all sizes of what the model may lack taken into "
    "account. Without the strongest trial: the same without the trial that says most for the causes; an effect enters "
    "only with enough of both. Tip moved: by these causes, root mean square, in the trial where it is most. Left "
    "unexplained: of what the base model lacks at the tip, in mean square. Probability: of the last cause in its "
    "place, the others staying."
)


def _search(record: DiagnosisRecord) -> str:
    """How causes were looked for."""
    if len(record.diagnosis.theories) <= 1 and record.diagnosis.screening.empty:
        return "The base model left nothing that was worth a search for causes."
    return (
        "One cause after another: beside those already in the model every effect of the library is tried to first "
        "order, the most promising are fitted together with the string's parameters, and the one with most evidence "
        "enters if it has enough of it whichever trial is left out. What the others make needless leaves again."
    )


def _theories(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The hypotheses with the least cost first; the base model is among the few that are shown."""
    rows = table.sort_values("fit_gain", ascending=False, kind="stable").reset_index(drop=True)
    late = (rows["causes"] == "") & (np.arange(len(rows)) >= FEW)
    order = np.where(late, FEW - 1.5, np.arange(len(rows)))
    return rows.iloc[np.argsort(order, kind="stable")].to_dict("records")


def _theories_table(theories: Sequence[Mapping[str, Any]]) -> Table:
    columns = ("causes", "log evidence", "without the strongest trial", "tip moved", "left unexplained")
    return Table((*columns, "probability"), [_theory(row) for row in theories])


def _theory(row: Mapping[str, Any]) -> list[Any]:
    weakest = row["held_out_gain"]
    return [
        plain(row["causes"]) if row["causes"] else "base model alone",
        number(gain(row["fit_gain"])),
        number(gain(weakest)) if np.isfinite(weakest) else Cell("not evaluated", "n missing"),
        number(mm(row["moved"], 1)),
        number(percent(row["unexplained"])),
        number(percent(row["probability"])),
    ]


# --- what is gained ---------------------------------------------------------------------------------
def gained(record: DiagnosisRecord) -> Section:
    """Base against extended model on trials that were left out of the fit."""
    title, table = "What is gained on trials left out of the fit", record.diagnosis.held_out
    if table.empty:
        nobody = "No trial was left out of the fit, so nobody can say how well the models predict."
        return Section(title, [Text(nobody, "missing")])
    ring = (
        " The ring is the extended model fitted to all of them."
        if len(record.models) > 1 and not _aside(record)
        else ""
    )
    further = f"Each trial as predicted from the others. Further left is better; noise alone leaves the mark.{ring}"
    right = "To the right of 0 the extended model is the likelier one on a trial that neither was fitted to."
    drawn, more = [Figure("Prediction of trials left out", predicted(record), further)], likelier(record)
    drawn += [Figure("Log-likelihood gained", more, right)] if more else []
    return Section(title, [*map(Text, _prediction(record)), Grid(drawn), Card("", [_held_out(record)])])


def _aside(record: DiagnosisRecord) -> bool:
    """Whether trials were set aside: left out of all fits, and of the choice of causes."""
    return not set(record.document["gain"]["held_out_trials"]) <= set(record.document["trials"]["used"])


def _prediction(record: DiagnosisRecord) -> list[Markup | str]:
    """How the trials were predicted, and which of them worse with the causes than without."""
    total, aside = record.document["gain"], _aside(record)
    who = "These trials were set aside, and predicted by" if aside else "Each trial was predicted by"
    if len(record.models) == 1:
        return [f"There is no extended model to compare. {who} the base model after it was fitted to the others."]
    chosen = "" if aside else " Which causes there are was chosen from all of them."
    rise = total["log_likelihood_per_trial"]
    error = "" if rise["standard_error"] is None else f" ± {gain(rise['standard_error'])} (standard error)"
    lead = f"{who} both models after they were fitted to the others.{chosen} The log-likelihood rises by "
    lead += f"{gain(rise['difference'])}{error} a trial; the matching rate E goes from "
    lead += f"{rate(total['matching_rate']['base'])} to {rate(total['matching_rate']['extended'])}."
    return [lead, *map(_worse_in_words, _worse(record))]


def _worse(record: DiagnosisRecord) -> list[dict[str, Any]]:
    """Trials that are predicted worse with the causes than without; and whether these explain them once fitted."""
    if len(record.models) == 1:
        return []
    table = record.diagnosis.held_out
    worse = table[table["rms_extended"] > WORSE * table["rms_base"]]
    known = worse.get("rms_known", worse["rms_extended"])
    return worse.assign(explained=WORSE * known < worse["rms_base"]).to_dict("records")


def _worse_in_words(row: Mapping[str, Any]) -> Markup:
    """row: of `_worse`."""
    than = f"{mm(row['rms_extended'], 1)} against {mm(row['rms_base'], 1)}"
    fitted = (
        f"Fitted to it as well, they leave {mm(row['rms_known'], 1)}: either it alone shows something of them, as of a "
        "plane that no other reaches, or they are not right. Another trial like it would tell."
    )
    said = bold(f"{row['trial']} is predicted worse with the causes than without, {than}.")
    return joined([said, fitted if row["explained"] else ""])


def _held_out(record: DiagnosisRecord) -> Table:
    """A row for each trial left out, and all together."""
    sides, total = record.models, record.document["gain"]
    extended = len(sides) > 1
    columns = ["trial", *(f"RMS {side}" for side in sides), "noise floor", *(f"tip {side}" for side in sides)]
    columns += [*(f"E {side}" for side in sides), *(["log-likelihood"] if extended else [])]
    rows = []
    for row in record.diagnosis.held_out.to_dict("records"):
        cells = [*(mm(row[f"rms_{side}"], 2) for side in sides), mm(row["noise_floor"], 2)]
        cells += [*(mm(row[f"tip_rms_{side}"], 2) for side in sides), *(rate(row[f"E_{side}"]) for side in sides)]
        cells += [gain(row["log_likelihood_difference"])] if extended else []
        rows.append([row["trial"], *map(number, cells)])
    cells = [*(mm(total["rms_m"][side], 2) for side in sides), mm(total["rms_m"]["noise_floor"], 2)]
    cells += [
        *(mm(total["tip_rms_m"][side], 2) for side in sides),
        *(rate(total["matching_rate"][side]) for side in sides),
    ]
    cells += [gain(total["log_likelihood_per_trial"]["difference"])] if extended else []
    return Table(columns, [*rows, [bold("all"), *map(number, cells)]])


# --- what is left -----------------------------------------------------------------------------------
def left(record: DiagnosisRecord) -> Section:
    """The section of the missing force, of what to try next, and of the model to go on with."""
    document = record.document
    parts: list[Part | None] = [Text(document["unexplained"]["sentence"]), _left_over(record), _next(record)]
    if not document["unexplained"]["sentence"]:
        parts = parts[1:]
    extension = Details("The extended model, as settings", [named(record.extension)])
    return Section("What is left", [*parts, extension], "left")


def _left_over(record: DiagnosisRecord) -> Part:
    """A picture of what nothing explains, or why there is none."""
    drawn, table = missing(record), record.diagnosis.missing
    if drawn:
        most = mm(float(np.hypot(table["x"], table["y"]).max()), 1)
        about = (
            "A row for each trial. Each arrow is how far the measured string lies from the model at its place s and "
            f"time, beyond noise, pointing as in the plane (right: +x, up: +y). The longest is {most}. Equally long "
            "arrows are equally much in all rows."
        )
        return Figure("What nothing explains", drawn, about)
    if len(record.models) > 1 or not record.diagnosis.causes.empty:
        share = percent(record.document["unexplained"]["fraction"])
        return Text(f"The extended model leaves {share} of what the base model lacks at the tip.")
    return Text("Less is left than is tolerated.")


def _next(record: DiagnosisRecord) -> Part | None:
    """The experiment that would tell more, with its motion if one is proposed."""
    following, drawn = record.document["next_experiment"], proposed(record)
    if not following:
        return None
    parts: list[Part] = [Text(following["sentence"], "")]
    if drawn:
        about = Markup(
            "The string on the motion proposed: as the likeliest theory has it, and as near to that as the others can "
            "come by moving their own parameters within what these trials allow. Left: where they are farthest apart. "
            "Right: over time, anywhere on the string. The motion is kept beside this page as {}; {} performs it and "
            "concludes."
        ).format(code("iterations/*/motion"), code("+experiment=decide"))
        parts.append(Figure("", drawn, about))
    return Card("What to try next", parts)


# --- the string
def string(record: DiagnosisRecord) -> Section | None:
    """The string's parameters, fitted without and with the causes."""
    base, known = record.document["base"]["parameters"], record.extension.get("known", {})
    value = {name: each["value"] if isinstance(each, Mapping) else each for name, each in known.items()}
    ends = [record.document.get(side, {}).get("intervals", {}) for side in ("base", "extended")]
    rows = [
        _parameter(p, (base[p.name], value.get(p.name)), [each.get(p.name) for each in ends])
        for p in record.model.parameters
        if p.name in base
    ]
    if not rows:
        return None
    lead = "Each model is fitted to all trials. What differs is what the base model bends to make up for its mistakes."
    columns = ("parameter", "", "base model", "95 % interval", "extended model", "95 % interval", "change", "unit")
    return Section("The string's parameters", [Text(lead), Card("", [Table(columns, rows), *_together(record)])])


def _together(record: DiagnosisRecord) -> list[Text]:
    """Parameters of the extended model that these trials tell together better than each alone, in a sentence."""
    pairs = record.document.get("extended", {}).get("correlations", [])
    said = [f"{' and '.join(map(plain, one['parameters']))} ({one['value']:+.2f})".replace("-", "−") for one in pairs]
    sentence = f"Known better together than each alone, by their correlation: {', '.join(said)}."
    return [Text(sentence, "caption")] if said else []


def _parameter(of: Parameter, values: tuple[float, float | None], ends: Sequence[Sequence[float] | None]) -> list[Any]:
    """A row: values of the base and of the extended model, each with the ends of its interval, if they are known."""
    base, extended = values
    change = "" if extended is None or not base else _change(extended / base)
    cells = [number(words) for value, two in zip(values, ends, strict=True) for words in _estimated(value, two)]
    return [Cell(plain(of.name), title=of.meaning), symbol(of.symbol), *cells, number(change), unit(of.unit)]


def _estimated(value: float | None, ends: Sequence[float] | None) -> tuple[str, str]:
    """A value and its interval, as far as they are known."""
    if value is None or ends is None:
        return UNKNOWN if value is None else significant(value), ""
    shown, low, high = within(value, *ends)
    return shown, f"{low} to {high}"


def _change(ratio: float) -> str:
    """A change in percent, or as a factor where it is large."""
    if not 1 / 3 < ratio < 3:
        return f"× {significant(ratio)}"
    percents = round(100 * (ratio - 1))
    return f"{percents:+d} %".replace("-", "−") if percents else "0 %"
