"""The evidence for a verdict as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np
import pandas as pd

from stringcast.data.diagnoses import (
    CAUSES,
    ENTRIES,
    HYPOTHESES,
    LIKENESS,
    MISSING,
    RESIDUALS,
    SCREENING,
)
from stringcast.stages.common import MM_PER_M
from stringcast.stages.diagnose.evidence.intervals import parameter_uncertainty
from stringcast.stages.diagnose.evidence.measures import (
    fixed_leave_one_out_gain,
    mean_explained_fraction,
    residuals_without_nuisance,
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.trials.prepared_data import PreparedData
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import (
    Effect,
    ModelChange,
    amplitude_parameters,
)
from stringcast.stages.model.library import effects_by_name

MAX_COMPARED_EFFECTS = 8  # the most promising
CELL_S = 0.02  # cells over which displacements are averaged
CELLS_ALONG_STRING = 4


def hypothesis_label(fit: Fit) -> str:
    """Make the label of a fit in tables from the names of its causes."""
    return " + ".join(sorted(fit.hypothesis.cause_names))


def residuals_table(prepared: PreparedData, base: Fit, extended: Fit) -> pd.DataFrame:
    """Build the table RESIDUALS: measured points and strings on an infinite mesh."""
    data = prepared.data
    frames = []
    base_residuals = residuals_without_nuisance(data, base)
    extended_residuals = residuals_without_nuisance(data, extended)
    for k, trial in enumerate(data.trials):
        measured = prepared.trials[k]
        base_offset = trial.displacements_m(base_residuals[k])
        extended_offset = trial.displacements_m(extended_residuals[k])
        base_points = measured.points + base_offset
        extended_points = measured.points + extended_offset
        along = string_tangents(trial.frame, trial.s, base_points)
        normal = base_offset[:, 1] * along[:, 0] - base_offset[:, 0] * along[:, 1]
        table = {
            "trial": trial.name,
            "t": trial.point_times,
            "s": trial.s,
            "sigma": measured.sigma,
            "x": measured.points[:, 0],
            "y": measured.points[:, 1],
            "total_sigma": trial.sigma,
            "base_x": base_points[:, 0],
            "base_y": base_points[:, 1],
            "extended_x": extended_points[:, 0],
            "extended_y": extended_points[:, 1],
            "base_tangential": -np.sum(base_offset * along, axis=1),
            "base_normal": -normal,
        }
        frames.append(pd.DataFrame(table))
    return RESIDUALS.check(pd.concat(frames, ignore_index=True))


def string_tangents(frame: np.ndarray, s: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Estimate unit vectors along the string at its points (N, 2) from neighbours."""
    along = np.zeros_like(points)
    for number in np.unique(frame):
        rows = np.flatnonzero(frame == number)
        if len(rows) > 1 and np.ptp(s[rows]) > 0:
            distinct = s[rows] + 1e-12 * np.arange(len(rows))
            along[rows] = np.gradient(points[rows], distinct, axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(length > 0, along / np.maximum(length, 1e-12), [1.0, 0.0])


def hypotheses_table(
    state: SelectionState,
    nested: Sequence[Fit],
    judgement: Judgement,
    tolerance_m: float,
) -> pd.DataFrame:
    """Build the table HYPOTHESES of all fits, the most evident first."""
    data = state.prepared.data
    base = nested[0]
    base_unexplained_m = unexplained_tip_rms(data, base)

    fits = list[Fit]()
    probabilities = dict[str, float]()
    for step in state.steps:
        fits += step.fits
    for posterior in judgement.posteriors:
        fits += posterior.fits.values()
        for name, fit in posterior.fits.items():
            label = hypothesis_label(fit)
            probabilities[label] = posterior.probabilities.get(name, 0.0)
    fits += [state.fit, *nested]
    # The last fit with the same causes is the most refined
    by_label = {hypothesis_label(fit): fit for fit in fits}

    rows = []
    for label, fit in by_label.items():
        explained = mean_explained_fraction(
            base_unexplained_m, unexplained_tip_rms(data, fit), tolerance_m
        )
        held_out_gain = np.nan
        if fit is not base:
            held_out_gain = fixed_leave_one_out_gain(base, fit)
        row = {
            "causes": label,
            "parameters": len(fit.chi),
            "mean_square": np.mean(np.concatenate(fit.residuals) ** 2),
            "fit_gain": fit.log_evidence - base.log_evidence,
            "held_out_gain": held_out_gain,
            "moved": tip_shift_rms(data, base, fit).max(),
            "unexplained": 1 - explained,
            "probability": probabilities.get(label, np.nan),
        }
        rows.append(row)
    table = pd.DataFrame(rows)
    table = table.sort_values("fit_gain", ascending=False, ignore_index=True)
    return HYPOTHESES.check(table)


def entries_table(data: TrialData, nested: Sequence[Fit]) -> pd.DataFrame:
    """Build the table ENTRIES from the fits with no cause, the first, and so on."""
    frames = []
    for number, (parent, extended) in enumerate(pairwise(nested), 1):
        gains = extended.log_likelihood_by_trial - parent.log_likelihood_by_trial
        residuals = {
            "before": residuals_without_nuisance(data, parent),
            "after": residuals_without_nuisance(data, extended),
        }
        for k, trial in enumerate(data.trials):
            squares = {}
            for name, by_trial in residuals.items():
                offset = trial.displacements_m(by_trial[k])
                squares[name] = np.sum(offset**2, axis=1)
            table = _average_in_cells(trial, squares)
            table[["before", "after"]] **= 0.5
            table = table.assign(
                number=number,
                cause=extended.hypothesis.cause_names[-1],
                log_likelihood=gains[k],
                evidence=extended.log_evidence - parent.log_evidence,
            )
            frames.append(table)
    if not frames:
        return ENTRIES.empty()
    return ENTRIES.check(pd.concat(frames, ignore_index=True))


def _average_in_cells(
    trial: PreparedTrial,
    columns: Mapping[str, np.ndarray],
) -> pd.DataFrame:
    """Average columns (n,) of a trial's points over cells in time and arc length."""
    table = pd.DataFrame({"t": trial.point_times, "s": trial.s, **columns})
    part = np.ceil(trial.s / trial.s.max() * CELLS_ALONG_STRING)
    part = part.clip(1, CELLS_ALONG_STRING)
    moment = np.floor((table["t"] - trial.times[0]) / CELL_S)
    means = table.groupby([moment, part]).mean().reset_index(drop=True)
    return means.assign(trial=trial.name)


def screening_table(state: SelectionState) -> pd.DataFrame:
    """Build the table SCREENING: the proposals of each step."""
    rows = []
    for step in state.steps:
        context = hypothesis_label(step.parent)
        for proposal in step.proposals:
            row = {
                "context": context,
                "effect": proposal.effect.name,
                "predicted_gain": proposal.gain,
            }
            rows.append(row)
    return SCREENING.from_rows(rows)


def likeness_table(state: SelectionState) -> pd.DataFrame:
    """Build the table LIKENESS of the most promising effects of the first step."""
    best = state.steps[0].proposals[:MAX_COMPARED_EFFECTS] if state.steps else []
    rows = []
    for other, proposal in combinations(best, 2):
        row = {
            "effect": proposal.effect.name,
            "other": other.effect.name,
            "cosine": proposal.cosine_similarity(other),
        }
        rows.append(row)
    return LIKENESS.from_rows(rows)


def causes_table(
    state: SelectionState,
    judgement: Judgement,
    half_width: float,
) -> pd.DataFrame:
    """Build the table CAUSES of the named causes, each with its intervals.

    Parameters
    ----------
    half_width : float
        Half width of the intervals in standard deviations.
    """
    data = state.prepared.data
    rows: list[dict[str, object]] = []
    for name in judgement.verdict.causes:
        effect = effects_by_name()[name]
        probability = judgement.inclusion_probability.get(name, 0.0)
        common: dict[str, object] = {"effect": name, "probability": probability}
        if issubclass(effect, ModelChange):
            common |= dict.fromkeys(("value", "low", "high"), np.nan)
            common |= dict.fromkeys(("meaning", "unit", "parameter"), "")
            rows.append(common | {"sentence": effect.describe({}), "at_least": False})
            continue

        fit = fit_containing(state, judgement, name)
        sentence = effect.describe(fit.cause_parameters(effect))
        between_trials_mm = MM_PER_M * data.between_trial_tip_rms(name)
        if between_trials_mm:
            sentence += (
                ", and differs from trial to trial, by about "
                f"{between_trials_mm:.0f} mm at the tip"
            )
        uncertainty = parameter_uncertainty(data, fit, judgement.background, half_width)
        intervals = uncertainty["intervals"]
        if may_be_absent(effect, intervals):
            sentence += "; small amounts of other effects may replace it"
        common["sentence"] = sentence
        for row in _parameter_rows(fit, effect, intervals):
            rows.append(common | row)
    return CAUSES.from_rows(rows)


def may_be_absent(
    effect: type[Effect], intervals: Mapping[str, Sequence[float]]
) -> bool:
    """Return whether the intervals of all amplitudes contain that of no effect.

    intervals: ends by qualified name of the parameters.
    """
    for parameter in amplitude_parameters(effect):
        low, high = intervals[effect.qualified_name(parameter)]
        if not low <= parameter.start <= high:
            return False
    return True


def fit_containing(state: SelectionState, judgement: Judgement, name: str) -> Fit:
    """Find the fit with a named cause: the final one, or that of a look-alike."""
    if name in state.fit.hypothesis.cause_names:
        return state.fit
    fits = []
    for posterior in judgement.posteriors:
        if name in posterior.fits:
            fits.append(posterior.fits[name])
    return max(fits, key=lambda fit: fit.log_evidence)


def _parameter_rows(
    fit: Fit,
    effect: type[Effect],
    intervals: Mapping[str, Sequence[float]],
) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for parameter in effect.parameters:
        name = effect.qualified_name(parameter)
        low, high = intervals[name]
        row: dict[str, object] = {
            "parameter": name,
            "meaning": parameter.meaning,
            "unit": parameter.unit,
            "value": fit.values[name],
            "low": low,
            "high": parameter.high if parameter.is_lower_bound else high,
            "at_least": parameter.is_lower_bound,
        }
        rows.append(row)
    return rows


def missing_table(data: TrialData, fit: Fit, criteria: Criteria) -> pd.DataFrame:
    """Build the table MISSING: unexplained displacements, if above the tolerance."""
    if unexplained_tip_rms(data, fit).max() < criteria.tip_tolerance_m:
        return MISSING.empty()
    frames = []
    pairs = zip(data.trials, mean_discrepancy(data, fit), strict=True)
    for trial, discrepancy in pairs:
        x, y = -trial.displacements_m(discrepancy).T
        frames.append(_average_in_cells(trial, {"x": x, "y": y}))
    return MISSING.check(pd.concat(frames, ignore_index=True))
