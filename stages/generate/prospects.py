"""Why a cast is likely to miss, which box it could hit, and what would help.

Log and page state this before the cast. The stated box lies on the path of a motion
that was tried; a plan for that box may do better.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from stringcast.stages.common import MM_PER_M
from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.hit_probability import (
    CastTask,
    SimulatedMotions,
    predict_outcome,
    simulate_motions,
)
from stringcast.stages.generate.learning import predictive_sd
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.target import Target

UNLIKELY_HIT = 0.5  # probability below which the reason is stated
LIKELY_HIT = 0.8
MAX_BOXES = 200  # boxes that are tried
# ratio of tip uncertainties below which another motion is recommended
MAX_INFORMATIVE_RATIO = 0.7
UNCERTAINTY, OBSTACLE, ARM = "uncertainty", "obstacle", "arm"
ARRIVAL = "arrival"
REASONS = {
    UNCERTAINTY: "most of the likely strings could hit, but by different motions",
    OBSTACLE: "on the best motion found, most strings touch an obstacle first",
    ARM: "no motion found within the arm's limits brings most of the likely strings "
    "there",
    ARRIVAL: "the best motion found brings most of the likely strings there, but not "
    "in the wanted direction or at the wanted speed",
}


def find_prospects(
    task: CastTask,
    candidates: Curves,
    chosen: int,
    samples: UncertaintySamples,
    validation: UncertaintySamples,
) -> dict[str, float | str]:
    """Find why the chosen motion may miss, a box it could hit, and what would help.

    Parameters
    ----------
    task : CastTask
        Model, target and obstacles.
    candidates : Curves
        Motions that were tried.
    chosen : int
        Index of the motion that is cast.
    samples, validation : UncertaintySamples
        Samples of the uncertain quantities, and independent ones to check a box.

    Returns
    -------
    dict
        Columns of table MOTION_OUTCOME.
    """
    motions = []
    for number in range(len(candidates.duration)):
        candidate = candidates.select(np.array([number]))
        motions.append(simulate_motions(task, candidate, samples))
    outcome = motions[chosen].judge(task)
    misses = ~outcome.hit[0]
    touched = misses & (outcome.free_share[0] < 1)
    hits = np.concatenate([motion.judge(task).hit for motion in motions])  # (M, K)
    limit = ARM
    if touched.sum() > misses.sum() / 2:
        limit = OBSTACLE
    elif hits.any(axis=0).mean() >= UNLIKELY_HIT:
        limit = UNCERTAINTY
    elif is_limited_by_arrival(task, motions[chosen]):
        limit = ARRIVAL
    prospects: dict[str, float | str] = {"limit": limit}

    for motion, box in likely_boxes(task, motions):
        moved = replace(task, target=box)
        hits = predict_outcome(moved, motion.curves, validation).hit
        if hits.mean() >= LIKELY_HIT:
            prospects["likely_x"], prospects["likely_y"] = box.x, box.y
            prospects["likely_chance"] = float(hits.mean())
            break

    if limit == UNCERTAINTY:
        tip_sd = predictive_sd(task, candidates, samples, chosen)
        prospects["tip_sd"] = float(tip_sd[chosen])
        prospects["taught_sd"] = float(tip_sd.min())
    return prospects


def is_limited_by_arrival(task: CastTask, motion: SimulatedMotions) -> bool:
    """Return whether a motion would hit if direction and speed did not matter."""
    if not task.target.restricts_arrival:
        return False
    box = replace(task.target, direction=None, speed=None)
    hits = motion.judge(replace(task, target=box)).hit
    return bool(hits.mean() >= UNLIKELY_HIT)


def likely_boxes(
    task: CastTask, motions: Sequence[SimulatedMotions]
) -> Iterator[tuple[SimulatedMotions, Target]]:
    """Yield boxes that a motion is likely to hit, with the motion, nearest box first.

    A box lies around the median tip at a tick at which the tips of many samples are
    near it. It is no farther from the target than the string is long.
    """
    target = task.target
    boxes = []  # distance from the target [m], number of the motion, centre [m]
    for number, motion in enumerate(motions):
        finite = np.isfinite(motion.simulated).all(axis=(1, 2, 3))
        if not finite.any():
            continue
        tips = motion.tip[finite]  # (K, T, 2)
        typical_tip = np.median(tips, axis=0)
        distances = target.distance_to_centre(typical_tip)
        near = (np.abs(tips - typical_tip) <= 2 * target.half_size).all(axis=-1)
        is_dense = near.mean(axis=0) >= LIKELY_HIT / 2
        is_close = distances <= task.model.string.length
        for tick in np.flatnonzero(is_dense & is_close):
            x, y = typical_tip[tick]
            boxes.append((distances[tick], number, float(x), float(y)))
    for _, number, x, y in sorted(boxes)[:MAX_BOXES]:
        box = replace(target, x=x, y=y)
        outcome = motions[number].judge(replace(task, target=box))
        if outcome.hit.mean() >= LIKELY_HIT:
            yield motions[number], box


def describe_prospects(outcome: pd.Series) -> str:
    """Describe why a motion is likely to miss, a box it could hit, and what would help.

    Parameters
    ----------
    outcome : Series
        The row of table MOTION_OUTCOME, with the columns of `find_prospects`.
    """
    chance, reason = outcome["chance"], REASONS[outcome["limit"]]
    sentences = [f"A hit is unlikely (probability {chance:.2f}): {reason}."]
    if np.isfinite(outcome.get("likely_chance", np.nan)):
        x, y = MM_PER_M * outcome[["likely_x", "likely_y"]].astype(float)
        away_m = np.hypot(
            outcome["likely_x"] - outcome["target_x"],
            outcome["likely_y"] - outcome["target_y"],
        )
        sentences.append(
            f"A motion is known that hits a target at ({x:.0f}, {y:.0f}) mm, "
            f"{MM_PER_M * away_m:.0f} mm away, with a probability of "
            f"{outcome['likely_chance']:.2f}."
        )
    tip_sd, taught_sd = outcome.get("tip_sd", np.nan), outcome.get("taught_sd", np.nan)
    if np.isfinite(tip_sd):
        known = f"After this cast the tip is known to {MM_PER_M * tip_sd:.0f} mm there"
        if taught_sd < MAX_INFORMATIVE_RATIO * tip_sd:
            known += (
                f", after the most informative motion that was tried to "
                f"{MM_PER_M * taught_sd:.0f} mm (generate.exploration=1)"
            )
        sentences.append(f"{known}.")
    return " ".join(sentences)
