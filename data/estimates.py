"""Artifacts of estimations: parameters of the string, and predictions with them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import pandas as pd

from stringcast.data.schema import Column, Table, parse_columns, tables_by_name

PARAMETERS = Table(
    "parameters",
    "the estimated parameters",
    parse_columns("""
    name (text): parameter
    symbol (text): its symbol in the paper; empty if it has none
    unit (text): its unit
    meaning (text): what it is
    value: best value, in `unit`
    low: lower end of the 95 % interval, in `unit`; NaN if the method gives none
    high: upper end of the 95 % interval, in `unit`; NaN if the method gives none
    minimum: lower end of the search range, in `unit`
    maximum: upper end of the search range, in `unit`
    chi [1]: exponent of the best value within its range, Eq. 3
    at_bound (bool): the value sits at an end of its range
    determined (bool): the data determine it
    """),
)
CANDIDATES = Table(
    "candidates",
    "all candidates that were tried; one more column for each parameter",
    parse_columns("""
    candidate [1] (int): number of the candidate, in the order tried
    matching_rate [1]: E, Eq. 5; NaN if the run was rejected
    finite (bool): the run stayed finite
    accepted (bool): it was the best so far
    """),
)
DRAWS = Table(
    "draws",
    "equally likely strings given the trials; one more column for each parameter",
    parse_columns("""
    draw [1] (int): number of the draw
    """),
)
MISFIT = Table(
    "misfit",
    "how far the estimate leaves the tip off in the last trial",
    parse_columns("""
    t [s]: time of the frame; 0 is the start of the movement
    x [m]: measured less simulated position of the measured point nearest the tip
    y [m]: measured less simulated position of the measured point nearest the tip
    mesh_x [m]: simulated position less that on a far finer mesh, where the parameters
        do not make up for it; else 0
    mesh_y [m]: simulated position less that on a far finer mesh, where the parameters
        do not make up for it; else 0
    hand_x [m]: position of the hand
    hand_y [m]: position of the hand
    """),
)
MATCHING = Table(
    "matching",
    "the matching rate frame by frame, before and after estimation",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    before [1]: E_f with the parameters before this estimation
    after [1]: E_f with the estimated parameters
    """),
)
ESTIMATION_SUMMARY = Table(
    "fit",
    "one row: how the estimation went",
    parse_columns("""
    method (text): how the parameters were estimated
    before [1]: E before
    after [1]: E after
    rms_before [m]: centre-line residual before, root mean square
    rms_after [m]: centre-line residual after, root mean square
    tip_before [m]: the same of the measured point nearest the tip
    tip_after [m]: the same of the measured point nearest the tip
    residual_ratio [1]: residual after over the points' sigma, root mean square; 1 for
        noise alone
    mesh_error [m]: error of the mesh that was subtracted before, root mean square; 0 if
        the parameters are those of the string on its mesh
    rejected [1] (int): candidates rejected because they did not stay finite
    sentence (text): what the data determine, in words
    """),
)


@dataclass(frozen=True)
class Estimate:
    """Parameters of the string, fitted to trials by `estimate`."""

    parameters: pd.DataFrame
    candidates: pd.DataFrame
    matching: pd.DataFrame
    fit: pd.DataFrame
    draws: pd.DataFrame = field(default_factory=DRAWS.empty)
    misfit: pd.DataFrame = field(default_factory=MISFIT.empty)

    TABLES: ClassVar = tables_by_name(
        PARAMETERS,
        CANDIDATES,
        MATCHING,
        ESTIMATION_SUMMARY,
        DRAWS,
        MISFIT,
    )

    def tables(self) -> dict[str, Table]:
        """Return TABLES with columns of the parameters in `candidates` and `draws`."""
        candidates, draws = list(CANDIDATES.columns), list(DRAWS.columns)
        rows = self.parameters[["name", "unit", "meaning"]]
        for name, unit, meaning in rows.itertuples(index=False):
            candidates.append(Column(name, unit, meaning))
            draws.append(Column(name, unit, meaning, optional=True))
        return self.TABLES | {
            "candidates": replace(CANDIDATES, columns=tuple(candidates)),
            "draws": replace(DRAWS, columns=tuple(draws)),
        }

    def values(self) -> dict[str, float]:
        """Return the best value of each parameter, by name."""
        return dict(zip(self.parameters["name"], self.parameters["value"], strict=True))

    @property
    def model_error_m(self) -> float:
        """Error of the model for motions unlike the trials [m]."""
        return float(self.fit["rms_after"].iloc[0])

    @property
    def residual_ratio(self) -> float:
        """Root mean square residual over the points' sigma; 1 for noise alone."""
        return float(self.fit["residual_ratio"].iloc[0])

    @property
    def mesh_error_m(self) -> float:
        """Mesh error that the fitted parameters do not compensate [m]."""
        return float(self.fit["mesh_error"].iloc[0])


PREDICTED = Table(
    "predicted",
    "every measured point of a trial that nothing was fitted to, and its prediction",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time; 0 is the start of the movement
    s [m]: arc length from the grasp
    x [m]: measured position
    y [m]: measured position
    predicted_x [m]: position in the model
    predicted_y [m]: position in the model
    """),
)
SCORE = Table(
    "score",
    "one row: the error in a trial that nothing was fitted to",
    parse_columns("""
    trial (text): name of the trial
    free [1] (int): parameters of this trial alone: of its initial state or rest
        position
    rms [m]: centre-line residual, root mean square
    tip [m]: the same of the measured point nearest the tip
    """),
)


@dataclass(frozen=True)
class Prediction:
    """The prediction of a trial before it is used in a fit, made by `predict`."""

    predicted: pd.DataFrame
    score: pd.DataFrame

    TABLES: ClassVar = tables_by_name(PREDICTED, SCORE)
