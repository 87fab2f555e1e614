"""Detection of points that belong to the hand of another trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from stringcast.stages.check.consistency.judge import (
    CONSISTENT_MISFIT,
    MAX_MISFIT_RATIO,
    MAX_TRIALS,
    Verdict,
    farthest_point,
    fit_trial,
)
from stringcast.stages.check.consistency.limits import Limit
from stringcast.stages.check.consistency.prediction import predict
from stringcast.stages.check.consistency.record import Measurements, Recording

# limits that the hand of another trial may break: those of distances from it
LIMITS_OF_OTHER_HANDS = {Limit.GAP, Limit.ORDER}
SUSPICIOUS_MISFIT = 0.1  # with more, points may belong to another hand


def tip_alone(recording: Recording, tip: str) -> Recording:
    """Return a trial with only its tip."""
    tracks = tuple(track for track in recording.tracks if track.point == tip)
    return replace(recording, tracks=tracks)


def find_pairing(measured: Measurements, verdict: Verdict) -> dict[str, str]:
    """Find trials whose points belong to the hand of another trial.

    Returns the trial whose points fit, by the trial of the hand; only where they
    differ.
    """
    limits = {broken.limit for broken in verdict.broken.values()}
    has_other_fault = not limits <= LIMITS_OF_OTHER_HANDS
    if measured.length is None or has_other_fault:
        return {}
    is_suspicious = max(verdict.misfits.values(), default=0.0) > SUSPICIOUS_MISFIT
    if not (verdict.broken or is_suspicious):
        return {}
    recordings = measured.recordings[: 2 * MAX_TRIALS]
    costs = pairing_costs(measured, recordings)
    if costs is None:
        return {}
    order, rung = cheapest_pairing(costs)
    hands = np.arange(len(recordings))
    changed = hands[order != hands]
    if not len(changed):
        return {}
    misfit_after = costs[changed, order[changed], rung]
    rung_before = int(costs[hands, hands].sum(axis=0).argmin())
    misfit_before = costs[changed, changed, rung_before]
    is_better = misfit_after.mean() <= MAX_MISFIT_RATIO * misfit_before.mean()
    if misfit_after.max() > CONSISTENT_MISFIT or not is_better:
        return {}
    return {recordings[i].name: recordings[order[i]].name for i in changed}


def pairing_costs(
    measured: Measurements, recordings: Sequence[Recording]
) -> np.ndarray | None:
    """Return the misfit of each trial's tip in each trial's hand, (N, N, C).

    The first index is that of the hand, the last that of the stiffness. Returns None if
    there is only one trial or a hand gives no prediction.
    """
    if len(recordings) < 2:
        return None
    tip = farthest_point(measured)
    tips = [tip_alone(recording, tip) for recording in recordings]
    rows = []
    for recording in recordings:
        prediction = predict(measured, recording)
        if prediction is None:
            return None
        row = []
        for other in tips:
            fit = fit_trial(prediction, other, tip) if other.tracks else None
            row.append(np.ones(len(prediction.nodes)) if fit is None else fit.misfits)
        rows.append(row)
    return np.array(rows)


def cheapest_pairing(costs: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the track of each hand (N,), and the index of the best stiffness."""
    hands = np.arange(len(costs))
    pairings = []
    for rung in range(costs.shape[2]):
        _, order = linear_sum_assignment(costs[:, :, rung])
        pairings.append((float(costs[hands, order, rung].sum()), rung, order))
    _, rung, order = min(pairings, key=lambda pairing: pairing[:2])
    return order, rung
