"""The evidence as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    CAUSES,
    ENTRIES,
    HYPOTHESES,
    LIKENESS,
    MISSING,
    RESIDUALS,
    SCREENING,
)
from stringcast.stages.diagnose.background_effects import (
    BackgroundPosterior,
    posterior_with_background,
)
from stringcast.stages.diagnose.document import MM_PER_M
from stringcast.stages.diagnose.forward_selection import (
    Criteria,
    SelectionState,
    mean_explained_fraction,
    min_leave_one_out_gain,
    tip_shift_rms,
    unexplained_tip_rms,
)
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.diagnose.verdict import Judgement
from stringcast.stages.inference.laplace import ABSENCE_TOLERANCE, Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, ModelChange, amplitude_parameters
from stringcast.stages.model.library import effects_by_name

MAX_COMPARED_EFFECTS = 8  # effects whose likeness is shown: the most promising
# [s], and parts of the string, that what is missing or explained is averaged over
CELL_SECONDS, CELLS_ALONG_STRING = 0.02, 4
# correlation beyond which two parameters are better read together than each by its
# interval
MIN_SHOWN_CORRELATION = 0.8


def hypothesis_label(fit: Fit) -> str:
    """As it stands in tables."""
    return " + ".join(sorted(fit.hypothesis.cause_names))


def residuals_table(prepared: PreparedData, base: Fit, extended: Fit) -> pd.DataFrame:
    """Table RESIDUALS: points as they were measured, and strings without numerical
    error.
    """
    frames, data = [], prepared.data
    plain_and_more = (
        data.for_hypothesis(fit.hypothesis).without_initial_state_error(
            fit.residuals, fit.scale_indices
        )
        for fit in (base, extended)
    )
    for raw, trial, plain, more in zip(
        prepared.trials, data.trials, *plain_and_more, strict=True
    ):
        off = trial.sigma[:, None] * plain.reshape(-1, 2)
        first, then = (
            raw.points + off,
            raw.points + trial.sigma[:, None] * more.reshape(-1, 2),
        )
        along = string_tangents(trial.frame, trial.s, first)
        table = {
            "trial": trial.name,
            "t": trial.times[trial.frame],
            "s": trial.s,
            "sigma": raw.sigma,
        }
        table |= dict(zip(("x", "y"), raw.points.T, strict=True)) | {
            "doubt": trial.sigma
        }
        table |= dict(
            zip(
                ("base_x", "base_y", "extended_x", "extended_y"),
                (*first.T, *then.T),
                strict=True,
            )
        )
        table["base_tangential"] = -np.sum(off * along, axis=1)
        table["base_normal"] = -(off[:, 1] * along[:, 0] - off[:, 0] * along[:, 1])
        frames.append(pd.DataFrame(table))
    return RESIDUALS.check(pd.concat(frames, ignore_index=True))


def string_tangents(frame: np.ndarray, s: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Unit vectors along the string at its points (N, 2), from their neighbours in the
    same frame.
    """
    along = np.zeros_like(points)
    for number in np.unique(frame):
        own = np.flatnonzero(frame == number)
        if len(own) > 1 and np.ptp(s[own]) > 0:
            along[own] = np.gradient(
                points[own], s[own] + 1e-12 * np.arange(len(own)), axis=0
            )
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(length > 0, along / np.maximum(length, 1e-12), [1.0, 0.0])


def hypotheses_table(
    found: SelectionState,
    by_cause: Sequence[Fit],
    judgement: Judgement,
    tolerance: float,
) -> pd.DataFrame:
    """Table HYPOTHESES: all that were fitted, those with most evidence first."""
    data, base = found.prepared.data, by_cause[0]
    lacking = unexplained_tip_rms(data, base)
    tried = {hypothesis_label(fit): fit for step in found.steps for fit in step.fits}
    tried |= {
        hypothesis_label(fit): fit
        for slot in judgement.posteriors
        for fit in slot.fits.values()
    }
    tried |= {hypothesis_label(fit): fit for fit in (found.fit, *by_cause)}
    chance = {
        hypothesis_label(slot.fits[n]): slot.probabilities.get(n, 0.0)
        for slot in judgement.posteriors
        for n in slot.fits
    }
    rows = [
        {
            "causes": name,
            "parameters": len(fit.chi),
            "mean_square": float(np.mean(np.concatenate(fit.residuals) ** 2)),
            "fit_gain": fit.log_evidence - base.log_evidence,
            "held_out_gain": min_leave_one_out_gain(base, fit)
            if fit is not base
            else np.nan,
            "moved": float(tip_shift_rms(data, base, fit).max()),
            "unexplained": 1
            - mean_explained_fraction(
                lacking, unexplained_tip_rms(data, fit), tolerance
            ),
            "probability": chance.get(name, 0.0),
        }
        for name, fit in tried.items()
    ]
    return HYPOTHESES.check(
        pd.DataFrame(rows).sort_values("fit_gain", ascending=False, ignore_index=True)
    )


def entries_table(data: TrialData, by_cause: Sequence[Fit]) -> pd.DataFrame:
    """Table ENTRIES. by_cause: the fits with no cause, with the first, and so on, to
    the same data.
    """
    frames = []
    for number, (less, more) in enumerate(pairwise(by_cause), 1):
        before, after = (
            data.for_hypothesis(fit.hypothesis).without_initial_state_error(
                fit.residuals, fit.scale_indices
            )
            for fit in (less, more)
        )
        rises = more.log_likelihood_by_trial - less.log_likelihood_by_trial
        for trial, rise, *both in zip(data.trials, rises, before, after, strict=True):
            squares = [
                np.sum((each.reshape(-1, 2) * trial.sigma[:, None]) ** 2, axis=1)
                for each in both
            ]
            table = _average_in_cells(
                trial, dict(zip(("before", "after"), squares, strict=True))
            )
            table[["before", "after"]] **= 0.5
            table = table.assign(
                number=number,
                cause=more.hypothesis.cause_names[-1],
                log_likelihood=rise,
            )
            frames.append(table.assign(evidence=more.log_evidence - less.log_evidence))
    return (
        ENTRIES.check(pd.concat(frames, ignore_index=True))
        if frames
        else ENTRIES.empty()
    )


def _average_in_cells(
    trial: PreparedTrial, columns: Mapping[str, np.ndarray]
) -> pd.DataFrame:
    """Columns (n,) of a trial's points, with their t and s, averaged over short times
    and parts of the string.
    """
    table = pd.DataFrame({"t": trial.times[trial.frame], "s": trial.s, **columns})
    part = np.ceil(trial.s / trial.s.max() * CELLS_ALONG_STRING).clip(
        1, CELLS_ALONG_STRING
    )
    moment = np.floor((table["t"] - trial.times[0]) / CELL_SECONDS)
    return (
        table.groupby([moment, part])
        .mean()
        .reset_index(drop=True)
        .assign(trial=trial.name)
    )


def screening_table(found: SelectionState) -> pd.DataFrame:
    """Table SCREENING."""
    rows = [
        {
            "context": hypothesis_label(step.parent),
            "effect": p.effect.name,
            "predicted_gain": p.gain,
        }
        for step in found.steps
        for p in step.proposals
    ]
    return SCREENING.check(pd.DataFrame(rows)) if rows else SCREENING.empty()


def likeness_table(found: SelectionState) -> pd.DataFrame:
    """Table LIKENESS: of the most promising effects of the first choice."""
    best = found.steps[0].proposals[:MAX_COMPARED_EFFECTS] if found.steps else []
    rows = [
        {
            "effect": a.effect.name,
            "other": b.effect.name,
            "cosine": a.cosine_similarity(b),
        }
        for b, a in combinations(best, 2)
    ]
    return LIKENESS.check(pd.DataFrame(rows)) if rows else LIKENESS.empty()


def causes_table(found: SelectionState, judgement: Judgement, z: float) -> pd.DataFrame:
    """Table CAUSES: those named, each as fitted among the others or in place of its
    look-alike. z: half width of the intervals in deviations.
    """
    rows: list[dict[str, object]] = []
    for name in judgement.causes:
        effect, common = (
            effects_by_name()[name],
            {
                "effect": name,
                "probability": judgement.inclusion_probability.get(name, 0.0),
            },
        )
        if issubclass(effect, ModelChange):
            nothing = dict.fromkeys(("value", "low", "high"), np.nan) | dict.fromkeys(
                ("meaning", "unit"), ""
            )
            rows.append(
                common
                | {
                    "sentence": effect.describe({}),
                    "parameter": "",
                    "at_least": False,
                    **nothing,
                }
            )
            continue
        fit = fit_containing(found, judgement, name)
        differs = MM_PER_M * found.prepared.data.between_trial_tip_rms(name)
        each_time = (
            f", and differs from trial to trial, by about {differs:.0f} mm at the tip"
            if differs
            else ""
        )
        common["sentence"] = (
            effect.describe(fit.cause_parameters(effect))
            + each_time
            + range_end_remark(fit, effect)
        )
        sure = posterior_with_background(found.prepared.data, fit, judgement.background)
        rows += [common | row for row in _parameter_rows(fit, effect, sure, z)]
    return CAUSES.check(pd.DataFrame(rows)) if rows else CAUSES.empty()


def fit_containing(found: SelectionState, judgement: Judgement, name: str) -> Fit:
    """The fit in which a cause that is named stands."""
    if name in found.fit.hypothesis.cause_names:
        return found.fit
    fits = [slot.fits[name] for slot in judgement.posteriors if name in slot.fits]
    return max(fits, key=lambda fit: fit.log_evidence)


def range_end_remark(fit: Fit, effect: type[Effect]) -> str:
    """What there is to say of sizes of a cause that end at an end of their range: of
    319 that were right one did.
    """
    sizes = [p for p in amplitude_parameters(effect) if not p.is_lower_bound]
    there = (
        np.abs(fit.chi - fit.hypothesis.exponents_from({})) > ABSENCE_TOLERANCE
    ) & (np.abs(fit.chi - 0.5) > 0.5 - ABSENCE_TOLERANCE)
    places = fit.hypothesis.parameter_indices(effect, sizes)
    ends = [
        effect.qualified_name(size)
        for size, place in zip(sizes, places, strict=True)
        if there[place]
    ]
    if not ends:
        return ""
    return f", with {' and '.join(ends)} at the end of the range: it may stand for what the library does not hold"


def _parameter_rows(
    fit: Fit, effect: type[Effect], sure: BackgroundPosterior, z: float
) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for parameter, place in zip(
        effect.parameters,
        fit.hypothesis.parameter_indices(effect, effect.parameters),
        strict=True,
    ):
        low, high = parameter_interval(fit, place, sure, z)
        high = parameter.high if parameter.is_lower_bound else high
        row: dict[str, object] = {
            "parameter": effect.qualified_name(parameter),
            "meaning": parameter.meaning,
        }
        value = float(parameter.value(fit.chi[place]))
        rows.append(
            row
            | {
                "unit": parameter.unit,
                "value": value,
                "low": low,
                "high": high,
                "at_least": parameter.is_lower_bound,
            }
        )
    return rows


def parameter_uncertainty(
    fit: Fit, sure: BackgroundPosterior, z: float
) -> dict[str, Any]:
    """How well the trials tell a fit's parameters, as diagnosis.json has it: the
    intervals of all, and pairs that these trials tell apart only in part, the most
    correlated first.
    """
    names, matrix = [p.name for p in fit.hypothesis.parameters], sure.correlation
    pairs = [
        (i, j)
        for i, j in combinations(range(len(names)), 2)
        if abs(matrix[i, j]) > MIN_SHOWN_CORRELATION
    ]
    pairs.sort(key=lambda pair: -abs(matrix[pair]))
    return {
        "intervals": {
            name: [*parameter_interval(fit, place, sure, z)]
            for place, name in enumerate(names)
        },
        "correlations": [
            {"parameters": [names[i], names[j]], "value": float(matrix[i, j])}
            for i, j in pairs
        ],
    }


def parameter_interval(
    fit: Fit, place: int, sure: BackgroundPosterior, z: float
) -> tuple[float, float]:
    """Ends of a parameter's interval, which holds its value."""
    chi, parameter = fit.chi[place], fit.hypothesis.parameters[place]
    ends = sure.mean[place] + z * np.array([-1.0, 1.0]) * sure.standard_deviation[place]
    low, high = parameter.value(
        np.clip([min(ends[0], chi), max(ends[1], chi)], 0.0, 1.0)
    )
    return float(low), float(high)


def missing_table(data: TrialData, fit: Fit, criteria: Criteria) -> pd.DataFrame:
    """Table MISSING: how the string is displaced beyond what the fit says, where that
    is more than is tolerated.
    """
    frames = []
    if unexplained_tip_rms(data, fit).max() < criteria.tolerance:
        return MISSING.empty()
    for trial, each in zip(data.trials, mean_discrepancy(data, fit), strict=True):
        x, y = -(each.reshape(-1, 2) * trial.sigma[:, None]).T
        frames.append(_average_in_cells(trial, {"x": x, "y": y}))
    return MISSING.check(pd.concat(frames, ignore_index=True))
