"""The artifact of a diagnosis: causes of a misfit, with their evidence."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, ClassVar

import pandas as pd

from stringcast.data.artifacts import (
    ATTEMPTS,
    COMMANDS,
    CONTROL_POINTS,
    PREDICTED_STRING,
    Motion,
    outcome_without_target,
)
from stringcast.data.schema import Table, parse_columns, tables_by_name

RESIDUALS = Table(
    "residuals",
    "every used measured point, and its position in the base and the extended model",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: measured position
    y [m]: measured position
    sigma [m]: noise floor of a coordinate
    total_sigma [m]: noise and numerical error together
    base_x [m]: the base model fitted to the trials that were used
    base_y [m]: the base model fitted to the trials that were used
    extended_x [m]: the extended model fitted to the trials that were used
    extended_y [m]: the extended model fitted to the trials that were used
    base_normal [m]: measured less base model, across the string, to its left
    base_tangential [m]: measured less base model, along the string, towards the tip
    """),
)
HYPOTHESES = Table(
    "hypotheses",
    "every set of causes that was fitted",
    parse_columns("""
    causes (text): active effects, joined by ' + '; empty for the base model
    parameters [1] (int): parameters fitted
    mean_square [1]: of the residual over noise and numerical error; 1 or less is noise
    fit_gain [1]: log evidence over the base model
    held_out_gain [1]: the same without the trial that gains most; NaN if not evaluated
    moved [m]: tip displacement by these causes, root mean square, largest trial
    unexplained [1]: unexplained share of the base model's mean-square tip residual
    probability [1]: of the last cause against its alternatives; NaN if not among them
    """),
)
ENTRIES = Table(
    "entries",
    "what each cause explains given those added before: by trial, time and arc length",
    parse_columns("""
    number [1] (int): of the cause in the order of addition, from 1
    cause (text): name
    evidence [1]: log evidence of the cause given those before it
    trial (text): name of the trial
    log_likelihood [1]: increase of the trial's log-likelihood
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    before [m]: residual without the cause, root mean square
    after [m]: the same with it
    """),
)
SCREENING = Table(
    "screening",
    "what each effect would explain to first order",
    parse_columns("""
    context (text): active causes, joined by ' + '
    effect (text): name
    predicted_gain [1]: of the log-likelihood
    """),
)
LIKENESS = Table(
    "likeness",
    "similarity of two effects in this data, after the fitted parameters are "
    "projected out",
    parse_columns("""
    effect (text): name
    other (text): name
    cosine [1]: between their displacements: 1 is indistinguishable
    """),
)
CAUSES = Table(
    "causes",
    "the reported causes, one row for each of their parameters",
    parse_columns("""
    effect (text): name
    probability [1]: of the cause
    sentence (text): the cause in words
    parameter (text): qualified name; empty if it has none
    meaning (text): what it is
    unit (text): its unit
    value: best value, in `unit`
    low: lower end of the 95 % interval, in `unit`
    high: upper end, in `unit`; of the range, where only the lower one is known
    at_least [1] (bool): only the lower end of the interval is known
    """),
)
HELD_OUT = Table(
    "held_out",
    "base and extended model on each trial, fitted without it",
    parse_columns("""
    trial (text): name of the trial
    rms_base [m]: centre-line residual
    rms_extended [m]: centre-line residual
    noise_floor [m]: residual of noise alone
    tip_rms_base [m]: residual at the largest arc length measured
    tip_rms_extended [m]: residual at the largest arc length measured
    E_base [1]: matching rate, Eq. 5
    E_extended [1]: matching rate, Eq. 5
    log_likelihood_difference [1]: extended less base
    rms_known [m]: of the extended model fitted to all trials of the search
    """),
)
MISSING = Table(
    "missing",
    "residual of the extended model beyond noise, where it exceeds the tolerance",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: along x
    y [m]: along y
    """),
)
PREDICTED_STRINGS = Table(
    "predicted",
    "the string on the proposed motion by each hypothesis, fitted to the likeliest one",
    parse_columns("""
    hypothesis (text): its causes, joined by ' + '; the likeliest comes first
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: position
    y [m]: position
    sigma [m]: noise and numerical error of all points that this one represents
    """),
)
DIAGNOSIS_SUMMARY = Table(
    "finding",
    "one row: the verdict",
    parse_columns("""
    verdict (text): none, effect, ambiguous, partial, unknown or insufficient
    sentence (text): in words
    diagnosis (text): diagnosis.json
    extended (text): the extended model as settings, YAML
    """),
)


@dataclass(frozen=True)
class Diagnosis:
    """The causes of the misfit between simulation and trials, made by `diagnose`."""

    finding: pd.DataFrame
    causes: pd.DataFrame
    held_out: pd.DataFrame
    residuals: pd.DataFrame
    hypotheses: pd.DataFrame
    entries: pd.DataFrame
    screening: pd.DataFrame
    likeness: pd.DataFrame
    missing: pd.DataFrame
    commands: pd.DataFrame
    control_points: pd.DataFrame
    predicted: pd.DataFrame

    TABLES: ClassVar = tables_by_name(
        DIAGNOSIS_SUMMARY,
        CAUSES,
        HELD_OUT,
        RESIDUALS,
        HYPOTHESES,
        ENTRIES,
        SCREENING,
        LIKENESS,
        MISSING,
        COMMANDS,
        CONTROL_POINTS,
        PREDICTED_STRINGS,
    )

    @property
    def verdict(self) -> str:
        """The verdict: none, effect, ambiguous, partial, unknown or insufficient."""
        return str(self.finding["verdict"].iloc[0])

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return str(self.finding["sentence"].iloc[0])

    @property
    def was_interrupted(self) -> bool:
        """Whether the search was ended before all candidates were compared."""
        return bool(self.document.get("interrupted"))

    @property
    def document(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        return dict(json.loads(self.finding["diagnosis"].iloc[0]))

    @property
    def motion(self) -> Motion | None:
        """The proposed motion that distinguishes look-alikes.

        It is None if no motion is proposed.
        """
        if self.commands.empty:
            return None
        hypothesis = self.predicted["hypothesis"]
        likeliest = self.predicted[hypothesis == hypothesis.iloc[0]]
        return Motion(
            self.commands,
            self.control_points,
            PREDICTED_STRING.check(likeliest[["t", "s", "x", "y"]]),
            ATTEMPTS.empty(),
            outcome_without_target(self.commands["t"].max(), 0),
        )
