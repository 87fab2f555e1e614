"""When an alignment is refused, and why: what is left, and what it goes with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.align.fit import AlignmentFit, AlignmentProblem, robust_sigma
from stringcast.stages.align.sightings import SightedTrial, points_on_links
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.effect import amplitude_parameters
from stringcast.stages.model.library import find_effects

MIN_FRAMES = 30  # in which the arm must be seen
MIN_HAND_SPEED = 0.1  # [m/s] a hand that never gets faster shows nothing of the clocks
MIN_SIGHTING_SPAN_M = 1e-3  # [m] spread that tells nothing of units
SCALE_RANGE = (0.7, 1.4)  # times as far as the joints say that what is seen may spread
MAX_MISFIT = 3.0  # times its own uncertainty that a residual may be
MAX_STRUCTURED_MISFIT = 1.5  # the same where it has a pattern
MIN_EXPLAINED_SHARE = 0.5  # share of it that the pattern explains
REQUIRED_PRECISION = {
    "time_offset.offset": (2e-3, "s"),
    "camera_rotation.angle": (0.02, "rad"),
    "pixel_scale.excess": (0.02, "1"),
}
MIN_EXCESS = 0.2  # share of the rest that something must explain to be named at all
RANGE_EDGE = 1e-3  # share of its range within which a parameter sits at its end


def max_hand_speed(arm: Arm, trial: SightedTrial) -> float:
    """The greatest speed of the hand in a trial [m/s]."""
    motion = trial.motion
    return float(
        np.linalg.norm(
            arm.grasp_velocity(motion.angles, motion.speeds)[..., :2], axis=-1
        ).max()
    )


def refuse_sight(problem: AlignmentProblem) -> None:
    """Refuse trials in which the arm is hardly seen, hardly moves, or is seen in other
    units. Raises DataError.
    """
    frames = sum(len(np.unique(trial.sightings.frame)) for trial in problem.trials)
    if frames < MIN_FRAMES:
        raise DataError(
            f"the arm is seen in {frames} frames only, {MIN_FRAMES} are needed. Film it longer, or light it."
        )
    fastest = max(max_hand_speed(problem.model.arm, trial) for trial in problem.trials)
    if fastest < MIN_HAND_SPEED:
        raise DataError(
            f"the hand moves at {fastest:.3f} m/s at most: too slow to compare clocks, {MIN_HAND_SPEED} m/s are needed. Swing it."
        )
    # of the arm as it is seen, over those that its reported motion makes expect: their
    # logarithms
    spreads = []
    for trial in problem.trials:
        seen = trial.sightings
        joints = problem.model.observed_arm(
            trial.motion, problem.model.values({})[None], seen.times
        )
        places = (seen.position, points_on_links(joints, seen)[0])
        sizes = [
            MIN_SIGHTING_SPAN_M + float(np.linalg.norm(np.ptp(each, axis=0)))
            for each in places
        ]
        spreads.append(np.log(sizes[0] / sizes[1]))
    ratio = np.exp(np.median(spreads))
    if not SCALE_RANGE[0] < ratio < SCALE_RANGE[1]:
        raise DataError(
            f"what is seen spreads {ratio:.3g} times as far as the joints say. x and y must be in metres, joint angles "
            "in radians; or correct camera.px_per_m and arm.links."
        )


def refuse_fit(problem: AlignmentProblem, fit: AlignmentFit) -> None:
    """Refuse a fit that is at an end of a range, leaves more than noise, or tells too
    little. Raises DataError.
    """
    low, high = problem.ranges(fit.names)
    for name, value, least, most in zip(fit.names, fit.x, low, high, strict=True):
        if value > most - RANGE_EDGE * (most - least) or (
            least < 0 and value < least + RANGE_EDGE * (most - least)
        ):
            raise DataError(
                f"{name} would be {value:.3g} or beyond, where the search ends. Correct conf/camera or conf/arm first."
            )
    refuse_misfit(problem, fit)
    for name, (most, unit) in REQUIRED_PRECISION.items():
        reach = fit.half_widths[fit.names.index(name)]
        if reach > most:
            fastest = max(
                max_hand_speed(problem.model.arm, trial) for trial in problem.trials
            )
            raise DataError(
                f"{name} would be known to +- {reach:.2g} {unit} only, {most:g} is needed: the hand reaches "
                f"{fastest:.2f} m/s. Swing it faster and further, or film it longer."
            )


def refuse_misfit(problem: AlignmentProblem, fit: AlignmentFit) -> None:
    """Refuse a fit that leaves much more than noise, or more than noise with a pattern.
    Raises DataError.
    """
    size = robust_sigma(fit.residual)
    if size < MAX_STRUCTURED_MISFIT:
        return

    # share of the weighted rest that each explains beyond the parameters that were
    # fitted
    root, shares = np.sqrt(fit.weight)[:, None], {}
    fixed, rest = root * fit.jacobian, root[:, 0] * fit.residual
    for words, columns in suspected_causes(problem, fit):
        both = root * np.concatenate([fit.jacobian, columns], axis=1)
        left = [
            float(np.sum((rest - a @ np.linalg.lstsq(a, rest, rcond=None)[0]) ** 2))
            for a in (fixed, both)
        ]
        shares[words] = 1 - left[1] / max(left[0], 1e-300)
    words, share = max(shares.items(), key=lambda one: one[1])
    if size < MAX_MISFIT and share < MIN_EXPLAINED_SHARE:
        return
    named = f"It is mostly as if {words}: that explains {100 * share:.0f} % of it."
    raise DataError(
        f"what is left is {size:.1f} times what noise explains. "
        f"{named if share > MIN_EXCESS else 'It goes with nothing that is known.'} Nothing is taken over."
    )


def suspected_causes(
    problem: AlignmentProblem, fit: AlignmentFit
) -> Iterator[tuple[str, np.ndarray]]:
    """Causes that could explain a remaining residual, as sentences, with the residual's
    change under each, (N, K).
    """
    yield (
        "the joints turned more or less than they report",
        residual_changes(problem, fit, "joint_gain", 1e-3),
    )
    yield (
        "a joint had play at its reversals",
        residual_changes(problem, fit, "backlash", 0.01),
    )
    lens = problem.jacobian(
        (*fit.names, "lens_distortion.radial"), np.append(fit.x, 0.0)
    )[:, -1:]
    yield (
        "the lens bent it, growing with the distance from the middle of the picture",
        lens,
    )
    lag = problem.jacobian(
        (*fit.names, "arm_lag.time_constant"), np.append(fit.x, 0.01)
    )[:, -1:]
    yield "the arm lagged, following its speed", lag
    links = np.concatenate([trial.sightings.link for trial in problem.trials])
    yield (
        "the outline lay beside the line from joint to joint",
        (links[:, None] == np.unique(links)).astype(float),
    )
    along = np.concatenate([trial.sightings.direction for trial in problem.trials])
    for moment in np.quantile(problem.times, np.linspace(0.1, 0.9, 17)):
        late = (problem.times > moment)[:, None]
        yield f"camera or arm was knocked at {moment:.2f} s", along * late


def residual_changes(
    problem: AlignmentProblem, fit: AlignmentFit, name: str, size: float
) -> np.ndarray:
    """Changes of the residuals over sigma by components of this size of a hand's
    effect, (N, K).
    """
    effect = find_effects([name])[0]
    model = problem.model.with_effects(effect)
    known = [
        fit.values,
        *(
            fit.values | {effect.qualified_name(p): size}
            for p in amplitude_parameters(effect)
        ),
    ]
    values = [model.values(each)[None] for each in known]
    off = np.stack(
        [
            np.concatenate([trial.residuals(model, one)[0] for trial in problem.trials])
            for one in values
        ]
    )
    return np.asarray((off[1:] - off[0]).T / problem.sigma[:, None])
