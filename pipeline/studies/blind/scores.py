"""Scores of a blind study, as tables: what was said of each bench, and how often it was
right.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence, Set

import numpy as np
import pandas as pd

from stringcast.data.schema import Column, Table
from stringcast.pipeline.studies.blind.verdicts import (
    RESOLUTION,
    SEVERAL,
    Answer,
    Row,
    answered,
    answers,
    confidence,
    correct,
    found_of_several,
    named_above,
)
from stringcast.pipeline.studies.counts import COUNTS, UNKNOWN_CODE, counted
from stringcast.stages.model.library import effects_by_name

BINS = np.linspace(0.0, 1.0, 11)  # of confidence
SIZES = np.array([5.0, 8.0, 12.0, 20.0, 30.0, np.inf])  # [sigma]
OWN = "own"  # laboratory of benches of the virtual lab itself
FIRST = 1  # version of rows of studies that were begun before they said so
CHANCE = 2000  # studies simulated for the calibration error that chance alone makes

BENCHES = Table(
    "benches",
    "a row a bench: what was hidden and what was said",
    (
        Column("seed", "1", "of the bench", "int"),
        Column("kind", "", "effect, none, outside, pair, triple or resolution", "text"),
        Column("truth", "", "what was hidden, joined by +", "text"),
        Column(
            "size",
            "1",
            "how far it moves the tip, in noise sigmas, base parameters refitted; least of several",
        ),
        Column("verdict", "", "of the diagnosis", "text"),
        Column(
            "answer",
            "",
            "first named, the true one if it is among the look-alikes named first",
            "text",
        ),
        Column("named", "", "all that was named, look-alikes joined by |", "text"),
        Column("correct", "", "the answer is right", "bool"),
        Column("confidence", "1", "probability of the answer; NaN if not stated"),
        Column(
            "group",
            "1",
            "how many look-alikes the answer has, itself included; 0 if nothing is named",
            "int",
        ),
        Column("extra", "1", "named beyond what is hidden", "int"),
        Column("found", "1", "how many of what is hidden are named", "int"),
        Column(
            "named_above_half",
            "",
            "a library effect was given a probability above 0.5",
            "bool",
        ),
        Column("rms_base", "m", "on held-out trials"),
        Column("rms_extended", "m", "on held-out trials"),
        Column("noise_floor", "m", "as estimated"),
        Column("runtime", "s", "of the diagnosis"),
        Column(
            "laboratory",
            "",
            "who drew the bench; where nothing says, the virtual lab",
            "text",
            optional=True,
        ),
        Column(
            "version", "1", "of the benches; see version.py of the laboratory", "int"
        ),
        Column(
            "code",
            "",
            "commit of the code that was asked, + if it was changed since; 'unknown' where nothing says",
            "text",
        ),
        Column(
            "half",
            "",
            "all that half of its trials named; empty if they were not asked",
            "text",
            optional=True,
        ),
        Column(
            "lost",
            "1",
            "how much of that is not named with all of them",
            "int",
            optional=True,
        ),
        Column(
            "values",
            "",
            "of true causes that were named, JSON: name, true, value, low, high, inside",
            "text",
        ),
    ),
)
PARAMETERS = Table(
    "parameters",
    "parameters of true causes that were named",
    (
        Column("seed", "1", "of the bench", "int"),
        Column("name", "", "qualified name", "text"),
        Column("true", "", "as hidden, in the parameter's unit"),
        Column("value", "", "as found"),
        Column("low", "", "lower end of its 95 % interval"),
        Column("high", "", "upper end"),
        Column("inside", "", "the interval holds the true value", "bool"),
    ),
)
CONFUSION = Table(
    "confusion",
    "how often what was hidden got which answer; pairs and triples are not in it",
    (
        Column("kind", "", "effect, none, outside or resolution", "text"),
        Column("truth", "", "what was hidden", "text"),
        Column("answer", "", "what was said", "text"),
        Column("count", "1", "how often", "int"),
    ),
)
BY_SIZE = Table(
    "by_size",
    "how often a hidden effect was found, by its size",
    (
        Column("kind", "", "effect (with resolution), outside, pair or triple", "text"),
        Column("from", "1", "least size of the bin [sigma]"),
        Column("to", "1", "largest size of the bin [sigma]"),
        Column("size", "1", "mean size in the bin [sigma]"),
        *COUNTS,
    ),
)
CALIBRATION = Table(
    "calibration",
    "how often answers were right, by the probability they were given",
    (
        Column("from", "1", "least probability of the bin"),
        Column("to", "1", "largest probability of the bin"),
        Column("confidence", "1", "mean probability in the bin"),
        *COUNTS,
    ),
)
RATES = Table(
    "rates",
    "the study in a few numbers, with the goals",
    (
        Column("name", "", "what is counted", "text"),
        *COUNTS,
        Column("at_least", "1", "goal; NaN if there is none"),
        Column("at_most", "1", "goal; NaN if there is none"),
    ),
)
ERROR = Table(
    "calibration_error",
    "one row: expected calibration error",
    (
        Column(
            "error",
            "1",
            "mean distance of share and confidence over the bins, weighted by count",
        ),
        Column(
            "chance",
            "1",
            "its mean if every answer were right with exactly the probability stated",
        ),
        Column("chance_high", "1", "95th percentile of the same"),
        Column("at_most", "1", "goal"),
        Column("count", "1", "answers with a probability", "int"),
    ),
)
RUNTIME = Table(
    "runtime",
    "one row: how long a diagnosis took",
    (
        Column("median", "s", "half took less"),
        Column("p95", "s", "95 of 100 took less"),
        Column("longest", "s", "the longest"),
        Column("at_most", "s", "goal"),
    ),
)
TABLES = {
    t.name: t
    for t in (
        BENCHES,
        PARAMETERS,
        CONFUSION,
        BY_SIZE,
        CALIBRATION,
        RATES,
        ERROR,
        RUNTIME,
    )
}


def scores(rows: Sequence[Row]) -> dict[str, pd.DataFrame]:
    """Every table of TABLES, by name. rows: of `one_bench`, at least one."""
    two_sided = frozenset(
        e.qualified_name(p)
        for e in effects_by_name().values()
        for p in e.parameters
        if not p.is_lower_bound
    )
    benches = BENCHES.check(pd.DataFrame([_bench(row, two_sided) for row in rows]))
    parameters = [
        {"seed": seed, **one}
        for seed, kept in benches[["seed", "values"]].to_numpy()
        for one in json.loads(kept)
    ]
    single = benches[~benches["kind"].isin(SEVERAL)]
    confusion = (
        single.groupby(["kind", "truth", "answer"]).size().rename("count").reset_index()
    )
    median, p95 = np.percentile(benches["runtime"], [50, 95])
    runtime = {
        "median": median,
        "p95": p95,
        "longest": benches["runtime"].max(),
        "at_most": 120.0,
    }
    calibration, error = _calibration(benches)
    made = {
        "benches": benches,
        "parameters": pd.DataFrame(parameters) if parameters else PARAMETERS.empty(),
        "confusion": confusion,
        "by_size": _by_size(benches),
        "calibration": calibration,
        "calibration_error": error,
        "runtime": pd.DataFrame([runtime]),
    }
    rates = []
    for name, kinds, chosen, at_least, at_most in COUNTED:
        some = benches[benches["kind"].isin(kinds)]
        rates.append(
            {
                "name": name,
                **counted(chosen(some)),
                "at_least": at_least,
                "at_most": at_most,
            }
        )
    inside = counted(made["parameters"]["inside"])
    rates.append(
        {
            "name": "parameter in its interval",
            **inside,
            "at_least": 0.93,
            "at_most": 0.97,
        }
    )
    made["rates"] = pd.DataFrame(rates)
    return {name: TABLES[name].check(frame) for name, frame in made.items()}


def _bench(row: Row, two_sided: Set[str]) -> dict[str, object]:
    """One row of BENCHES. two_sided: names of parameters whose interval has two ends."""
    truth, diagnosis, said = row["truth"], row["diagnosis"], answers(row)
    half = answers({**row, "diagnosis": row["half"]}) if "half" in row else []
    rms = (diagnosis.get("gain") or {}).get("rms_m") or {}
    return {
        "seed": row["seed"],
        "kind": truth["kind"],
        "truth": "+".join(truth["names"]) or "none",
        "size": min(truth["sizes"].values(), default=np.nan),
        "verdict": diagnosis["verdict"],
        "answer": answered(row),
        "named": _written(said),
        "correct": correct(row),
        "confidence": confidence(row),
        "group": len(said[0]) if said else 0,
        "extra": sum(not group & set(truth["names"]) for group in said),
        "found": found_of_several(row),
        "named_above_half": named_above(row, 0.5),
        "rms_base": rms.get("base", np.nan),
        "rms_extended": rms.get("extended", np.nan),
        "noise_floor": rms.get("noise_floor", np.nan),
        "runtime": row["runtime"],
        "laboratory": truth.get("laboratory", OWN),
        "version": row.get("version", FIRST),
        "code": row.get("code", UNKNOWN_CODE),
        "half": _written(half),
        "lost": sum(not any(group & other for other in said) for group in half),
        "values": json.dumps(_parameters(row, two_sided)),
    }


def _written(said: Sequence[Answer]) -> str:
    return " ".join("|".join(sorted(group)) for group in said)


def _parameters(row: Row, two_sided: Set[str]) -> list[dict[str, object]]:
    """Rows of PARAMETERS: those of true causes that were named with an interval.
    two_sided: names of those whose interval has two ends.
    """
    true = row["truth"]["parameters"]
    stated = {
        n: p
        for cause in row["diagnosis"].get("causes") or []
        for n, p in cause.get("parameters", {}).items()
    }
    return [
        {
            "name": name,
            "true": true[name],
            **{k: p[k] for k in ("value", "low", "high")},
        }
        | {"inside": bool(p["low"] <= true[name] <= p["high"])}
        for name, p in stated.items()
        if name in true
        and name in two_sided
        and p.get("low") is not None
        and p.get("high") is not None
    ]


def _by_size(benches: pd.DataFrame) -> pd.DataFrame:
    kinds = benches.assign(kind=benches["kind"].replace(RESOLUTION, "effect"))
    sized = kinds[kinds["size"].notna()]
    parts = sized.groupby(["kind", np.digitize(sized["size"], SIZES) - 1])
    rows = [
        {
            "kind": kind,
            "from": SIZES[i],
            "to": SIZES[i + 1],
            "size": some["size"].mean(),
            **counted(some["correct"]),
        }
        for (kind, i), some in parts
        if 0 <= i < len(SIZES) - 1
    ]
    return pd.DataFrame(rows) if rows else BY_SIZE.empty()


def _calibration(benches: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables CALIBRATION and ERROR: of answers with a probability, how many are right,
    and how far off that is.
    """
    stated = benches[benches["confidence"].notna()]
    p, right = stated["confidence"].to_numpy(), stated["correct"].to_numpy()
    rows = [
        {
            "from": BINS[i],
            "to": BINS[i + 1],
            "confidence": some["confidence"].mean(),
            **counted(some["correct"]),
        }
        for i, some in stated.groupby(_bin(p))
    ]
    by_chance = np.random.default_rng(0).uniform(size=(CHANCE, len(p))) < p
    chance = [calibration_error(p, one) for one in by_chance] if len(p) else [np.nan]
    error = {
        "error": calibration_error(p, right),
        "chance": np.mean(chance),
        "chance_high": np.percentile(chance, 95),
    }
    table = pd.DataFrame(rows) if rows else CALIBRATION.empty()
    return table, pd.DataFrame([error | {"at_most": 0.05, "count": len(p)}])


def calibration_error(p: np.ndarray, right: np.ndarray) -> float:
    """Expected calibration error of probabilities p (N,) of answers that were right or
    not (N,), in BINS.

    Naeini, Cooper and Hauskrecht (2015). NaN for none.
    """
    if len(p) == 0:
        return float("nan")
    excess = np.bincount(_bin(p), weights=right - p, minlength=len(BINS) - 1)
    return float(np.abs(excess).sum() / len(p))


def _bin(p: np.ndarray) -> np.ndarray:
    """Bin of each probability."""
    return np.clip(np.digitize(p, BINS) - 1, 0, len(BINS) - 2)


Chosen = Callable[[pd.DataFrame], pd.Series]
# What is counted, of which benches, what of them, and the goal: at least, at most.
COUNTED: tuple[tuple[str, tuple[str, ...], Chosen, float, float], ...] = (
    (
        "cause found",
        ("effect", "resolution", *SEVERAL),
        lambda b: b["correct"],
        0.95,
        np.nan,
    ),
    (
        "single effect found",
        ("effect", "resolution"),
        lambda b: b["correct"],
        0.95,
        np.nan,
    ),
    ("pair found", ("pair",), lambda b: b["correct"], 0.95, np.nan),
    ("one of a pair found", ("pair",), lambda b: b["found"] >= 1, np.nan, np.nan),
    ("triple found", ("triple",), lambda b: b["correct"], 0.75, np.nan),
    (
        "found without look-alikes",
        ("effect", "resolution"),
        lambda b: b["correct"] & (b["group"] == 1),
        np.nan,
        np.nan,
    ),
    (
        "more named than there is",
        ("effect", "resolution", *SEVERAL),
        lambda b: b["extra"] > 0,
        np.nan,
        np.nan,
    ),
    ("false alarm", ("none",), lambda b: ~b["correct"], np.nan, 0.02),
    ("outside called unknown", ("outside",), lambda b: b["correct"], 0.90, np.nan),
    (
        "outside named above 0.5",
        ("outside",),
        lambda b: b["named_above_half"],
        np.nan,
        0.0,
    ),
    (
        "named with half, lost with all",
        ("effect", "resolution", *SEVERAL, "none", "outside"),
        lambda b: b.loc[b["half"] != "", "lost"] > 0,
        np.nan,
        0.05,
    ),
)
