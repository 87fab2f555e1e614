"""Scores of a diagnosis study, as tables.

They hold the answer to each dataset, and how often answers are right.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence, Set

import numpy as np
import pandas as pd

from stringcast.data.schema import Table, parse_columns
from stringcast.pipeline.paper.scores import SHARE_COLUMNS, share_with_interval
from stringcast.stages.model.library import effects_by_name
from tests.benchmarks.diagnosis.answers import (
    SEVERAL,
    Row,
    answer_name,
    answer_probability,
    count_false,
    count_found,
    is_correct,
    is_named_above,
    named_groups,
    reports_remainder,
)

PROBABILITY_BINS = np.linspace(0.0, 1.0, 11)
SIZE_BINS_SIGMAS = np.array([5.0, 8.0, 12.0, 20.0, 30.0, np.inf])
# simulated studies, for the calibration error by chance alone
CHANCE_SAMPLES = 2000
RUNTIME_GOAL_S = 120.0

RECORDED_COLUMNS = parse_columns("""
    simulator (text): reference simulator that drew the dataset
    seed [1] (int): of the dataset
    kind (text): effect, pair, triple, none, outside or mixed
    truth (text): hidden causes, joined by +
    size [1]: tip shift of the smallest hidden cause, base parameters refitted, in noise
        sigmas
    verdict (text): of the diagnosis
    named (text): named causes, look-alikes joined by |
    correct (bool): the answer is right
    confidence [1]: probability of the answer; NaN if none is stated
    extra [1] (int): named causes that are not hidden
    runtime [s]: of the diagnosis
    code (text): commit of the code, + if it was changed since
    values (text): parameters of hidden causes that were named, JSON: name, true, value,
        low, high, inside
    """)
RECORDED = Table(
    "diagnoses",
    "a row a synthetic dataset: what it hides and its diagnosis",
    RECORDED_COLUMNS,
)
DIAGNOSES = Table(
    "diagnoses",
    RECORDED.meaning,
    (
        *RECORDED_COLUMNS,
        *parse_columns("""
        answer (text): first named, the true one if it is among the look-alikes named
            first
        group [1] (int): look-alikes of the answer, itself included; 0 if nothing is
            named
        found [1] (int): hidden causes that are named
        remainder (bool): a part of the misfit is said to be left
        named_above_half (bool): a library effect has a probability above 0.5
        rms_base [m]: residual of the base model in left-out trials
        rms_extended [m]: residual of the extended model in left-out trials
        noise_floor [m]: as estimated
        """),
    ),
)
PARAMETERS = Table(
    "parameters",
    "parameters of hidden causes that were named",
    parse_columns("""
    seed [1] (int): of the dataset
    name (text): qualified name
    true: in the parameter's unit
    value: estimate
    low: lower end of its 95 % interval
    high: upper end
    inside (bool): the interval holds the true value
    """),
)
CONFUSION = Table(
    "confusion",
    "counts of answers by hidden cause, without pairs and triples",
    parse_columns("""
    kind (text): effect, none or outside
    truth (text): what was hidden
    answer (text): the answer
    count [1] (int): datasets
    """),
)
BY_SIZE = Table(
    "by_size",
    "share of right answers by size of the hidden cause",
    (
        *parse_columns("""
        kind (text): effect, outside, mixed, pair or triple
        from [1]: least size of the bin [sigma]
        to [1]: largest size of the bin [sigma]
        size [1]: mean size in the bin [sigma]
        """),
        *SHARE_COLUMNS,
    ),
)
CALIBRATION = Table(
    "calibration",
    "share of right answers by their stated probability",
    (
        *parse_columns("""
        from [1]: least probability of the bin
        to [1]: largest probability of the bin
        confidence [1]: mean probability in the bin
        """),
        *SHARE_COLUMNS,
    ),
)
RATES = Table(
    "rates",
    "the study in a few numbers, with goals",
    (
        *parse_columns("""
        name (text): what is counted
        """),
        *SHARE_COLUMNS,
        *parse_columns("""
        at_least [1]: goal; NaN if there is none
        at_most [1]: goal; NaN if there is none
        """),
    ),
)
ERROR = Table(
    "calibration_error",
    "one row: expected calibration error",
    parse_columns("""
    error [1]: mean distance of share and confidence over the bins, weighted by count
    chance [1]: its mean if every answer were right with exactly the probability stated
    chance_high [1]: 95th percentile of the same
    at_most [1]: goal
    count [1] (int): answers with a probability
    """),
)
RUNTIME = Table(
    "runtime",
    "one row: seconds of a diagnosis",
    parse_columns("""
    median [s]: median
    p95 [s]: 95th percentile
    longest [s]: maximum
    at_most [s]: goal
    """),
)
TABLES = {
    t.name: t
    for t in (
        DIAGNOSES,
        PARAMETERS,
        CONFUSION,
        BY_SIZE,
        CALIBRATION,
        RATES,
        ERROR,
        RUNTIME,
    )
}


def score_rows(rows: Sequence[Row]) -> dict[str, pd.DataFrame]:
    """Return every table of TABLES, by name.

    `rows` are those of `DatasetJob`, at least one.
    """
    two_sided = set()
    for effect in effects_by_name().values():
        two_sided |= {
            effect.qualified_name(p) for p in effect.parameters if not p.is_lower_bound
        }
    diagnoses = DIAGNOSES.check(
        pd.DataFrame([diagnosis_row(row, two_sided) for row in rows])
    )
    parameters = parameter_rows(diagnoses)
    single = diagnoses[~diagnoses["kind"].isin(SEVERAL)]
    median, p95 = np.percentile(diagnoses["runtime"], [50, 95])
    runtime = {
        "median": median,
        "p95": p95,
        "longest": diagnoses["runtime"].max(),
        "at_most": RUNTIME_GOAL_S,
    }
    calibration, error = count_calibration(diagnoses)
    tables = {
        "diagnoses": diagnoses,
        "parameters": parameters,
        "confusion": single.groupby(["kind", "truth", "answer"])
        .size()
        .rename("count")
        .reset_index(),
        "by_size": count_by_size(diagnoses),
        "calibration": calibration,
        "calibration_error": error,
        "runtime": pd.DataFrame([runtime]),
        "rates": count_rates(diagnoses, parameters),
    }
    return {name: TABLES[name].check(frame) for name, frame in tables.items()}


def diagnosis_row(row: Row, two_sided: Set[str]) -> dict[str, object]:
    """Return one row of DIAGNOSES.

    `two_sided` names the parameters whose interval has two ends.
    """
    truth, diagnosis, groups = row["truth"], row["diagnosis"], named_groups(row)
    rms = (diagnosis.get("gain") or {}).get("rms_m") or {}
    return {
        "simulator": truth["simulator"],
        "seed": row["seed"],
        "kind": truth["kind"],
        "truth": "+".join(truth["names"]) or "none",
        "size": min(truth["sizes"].values(), default=np.nan),
        "verdict": diagnosis["verdict"],
        "named": " ".join("|".join(sorted(group)) for group in groups),
        "correct": is_correct(row),
        "confidence": answer_probability(row),
        "extra": count_false(row),
        "runtime": row["runtime"],
        "code": row["code"],
        "values": json.dumps(hidden_parameters(row, two_sided)),
        "answer": answer_name(row),
        "group": len(groups[0]) if groups else 0,
        "found": count_found(row),
        "remainder": reports_remainder(row),
        "named_above_half": is_named_above(row, 0.5),
        "rms_base": rms.get("base", np.nan),
        "rms_extended": rms.get("extended", np.nan),
        "noise_floor": rms.get("noise_floor", np.nan),
    }


def hidden_parameters(row: Row, two_sided: Set[str]) -> list[dict[str, object]]:
    """Return parameters of named hidden causes whose interval has two ends."""
    true = row["truth"]["parameters"]
    rows = []
    for cause in row["diagnosis"].get("causes") or []:
        for name, estimate in cause.get("parameters", {}).items():
            low, high = estimate.get("low"), estimate.get("high")
            if (
                name in true
                and name in two_sided
                and low is not None
                and high is not None
            ):
                inside = bool(low <= true[name] <= high)
                limits = {
                    "value": estimate["value"],
                    "low": low,
                    "high": high,
                    "inside": inside,
                }
                rows.append({"name": name, "true": true[name], **limits})
    return rows


def parameter_rows(diagnoses: pd.DataFrame) -> pd.DataFrame:
    """Return table PARAMETERS of the column `values`."""
    rows = []
    for seed, values in zip(diagnoses["seed"], diagnoses["values"], strict=True):
        rows += [{"seed": seed, **value} for value in json.loads(values)]
    return pd.DataFrame(rows) if rows else PARAMETERS.empty()


def count_by_size(diagnoses: pd.DataFrame) -> pd.DataFrame:
    """Return table BY_SIZE."""
    sized = diagnoses[diagnoses["size"].notna()]
    rows = []
    for (kind, i), group in sized.groupby(
        ["kind", np.digitize(sized["size"], SIZE_BINS_SIGMAS) - 1]
    ):
        if 0 <= i < len(SIZE_BINS_SIGMAS) - 1:
            limits = {
                "from": SIZE_BINS_SIGMAS[i],
                "to": SIZE_BINS_SIGMAS[i + 1],
                "size": group["size"].mean(),
            }
            rows.append(
                {"kind": kind, **limits, **share_with_interval(group["correct"])}
            )
    return pd.DataFrame(rows) if rows else BY_SIZE.empty()


def count_calibration(diagnoses: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return tables CALIBRATION and ERROR, of answers with a stated probability."""
    stated = diagnoses[diagnoses["confidence"].notna()]
    p, correct = stated["confidence"].to_numpy(), stated["correct"].to_numpy()
    rows = []
    for i, group in stated.groupby(probability_bin(p)):
        row = {
            "from": PROBABILITY_BINS[i],
            "to": PROBABILITY_BINS[i + 1],
            "confidence": group["confidence"].mean(),
        }
        rows.append(row | share_with_interval(group["correct"]))
    simulated = np.random.default_rng(0).uniform(size=(CHANCE_SAMPLES, len(p))) < p
    chance = (
        [calibration_error(p, sample) for sample in simulated] if len(p) else [np.nan]
    )
    error = {
        "error": calibration_error(p, correct),
        "chance": np.mean(chance),
        "chance_high": np.percentile(chance, 95),
        "at_most": 0.05,
        "count": len(p),
    }
    return pd.DataFrame(rows) if rows else CALIBRATION.empty(), pd.DataFrame([error])


def calibration_error(p: np.ndarray, correct: np.ndarray) -> float:
    """Return the expected calibration error of probabilities p (N,).

    It compares them with answers that were right or not (N,), and is NaN for none.
    Reference: Naeini, Cooper and Hauskrecht (2015).
    """
    if len(p) == 0:
        return float("nan")
    excess = np.bincount(
        probability_bin(p), weights=correct - p, minlength=len(PROBABILITY_BINS) - 1
    )
    return float(np.abs(excess).sum() / len(p))


def probability_bin(p: np.ndarray) -> np.ndarray:
    """Return the bin of each probability."""
    return np.clip(np.digitize(p, PROBABILITY_BINS) - 1, 0, len(PROBABILITY_BINS) - 2)


Select = Callable[[pd.DataFrame], pd.Series]
SINGLE = ("effect",)
# name, kinds of datasets, condition of a right answer, lower and upper goal
COUNTED: tuple[tuple[str, tuple[str, ...], Select, float, float], ...] = (
    ("cause found", (*SINGLE, *SEVERAL), lambda d: d["correct"], 0.95, np.nan),
    ("single cause found", SINGLE, lambda d: d["correct"], 0.95, np.nan),
    ("pair found", ("pair",), lambda d: d["correct"], 0.95, np.nan),
    ("one of a pair found", ("pair",), lambda d: d["found"] >= 1, np.nan, np.nan),
    ("triple found", ("triple",), lambda d: d["correct"], 0.75, np.nan),
    (
        "found without look-alikes",
        SINGLE,
        lambda d: d["correct"] & (d["group"] == 1),
        np.nan,
        np.nan,
    ),
    (
        "more named than hidden",
        (*SINGLE, *SEVERAL),
        lambda d: d["extra"] > 0,
        np.nan,
        np.nan,
    ),
    ("false alarm", ("none",), lambda d: ~d["correct"], np.nan, 0.02),
    ("outside called unknown", ("outside",), lambda d: d["correct"], 0.90, np.nan),
    (
        "outside named above 0.5",
        ("outside",),
        lambda d: d["named_above_half"],
        np.nan,
        0.0,
    ),
    ("mixed: known cause named", ("mixed",), lambda d: d["found"] >= 1, 0.90, np.nan),
    ("mixed: false cause named", ("mixed",), lambda d: d["extra"] > 0, np.nan, 0.03),
    ("mixed: remainder reported", ("mixed",), lambda d: d["remainder"], 0.97, np.nan),
)


def count_rates(diagnoses: pd.DataFrame, parameters: pd.DataFrame) -> pd.DataFrame:
    """Return table RATES."""
    rows = []
    for name, kinds, select, at_least, at_most in COUNTED:
        group = diagnoses[diagnoses["kind"].isin(kinds)]
        rows.append(
            {
                "name": name,
                **share_with_interval(select(group)),
                "at_least": at_least,
                "at_most": at_most,
            }
        )
    inside = share_with_interval(parameters["inside"])
    rows.append(
        {
            "name": "true value in its interval",
            **inside,
            "at_least": 0.93,
            "at_most": 0.97,
        }
    )
    return pd.DataFrame(rows)
