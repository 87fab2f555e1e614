"""When an alignment is refused, and why: what is left, and what it goes with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.align.fit import Fit, Problem, robust
from stringcast.stages.align.sightings import Sighted, on_links
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.effect import amplitude_parameters
from stringcast.stages.model.library import find_effects

FRAMES = 30  # in which the arm must be seen
SLOW = 0.1  # [m/s] a hand that never gets faster shows nothing of the clocks
TINY = 1e-3  # [m] spread that tells nothing of units
UNITS = (0.7, 1.4)  # times as far as the joints say that what is seen may spread
MISFIT = 3.0  # times its own uncertainty that a residual may be
VISIBLE = 1.5  # the same where it has a pattern
MOSTLY = 0.5  # share of it that the pattern explains
CERTAIN = {
    "time_offset.offset": (2e-3, "s"),
    "camera_rotation.angle": (0.02, "rad"),
    "pixel_scale.excess": (0.02, "1"),
}
LEFT = 0.2  # share of the rest that something must explain to be named at all
EDGE = 1e-3  # share of its range within which a parameter sits at its end


def speed(arm: Arm, trial: Sighted) -> float:
    """The greatest speed of the hand in a trial [m/s]."""
    motion = trial.motion
    return float(
        np.linalg.norm(
            arm.grasp_velocity(motion.angles, motion.speeds)[..., :2], axis=-1
        ).max()
    )


def refuse_sight(problem: Problem) -> None:
    """Refuse trials in which the arm is hardly seen, hardly moves, or is seen in other
    units. Raises DataError.
    """
    frames = sum(len(np.unique(trial.sightings.frame)) for trial in problem.trials)
    if frames < FRAMES:
        raise DataError(
            f"the arm is seen in {frames} frames only, {FRAMES} are needed. Film it longer, or light it."
        )
    fastest = max(speed(problem.model.arm, trial) for trial in problem.trials)
    if fastest < SLOW:
        raise DataError(
            f"the hand moves at {fastest:.3f} m/s at most: too slow to compare clocks, {SLOW} m/s are needed. Swing it."
        )
    # of the arm as it is seen, over those that its reported motion makes expect: their
    # logarithms
    spreads = []
    for trial in problem.trials:
        seen = trial.sightings
        joints = problem.model.observed_arm(
            trial.motion, problem.model.values({})[None], seen.times
        )
        places = (seen.seen, on_links(joints, seen)[0])
        sizes = [TINY + float(np.linalg.norm(np.ptp(each, axis=0))) for each in places]
        spreads.append(np.log(sizes[0] / sizes[1]))
    ratio = np.exp(np.median(spreads))
    if not UNITS[0] < ratio < UNITS[1]:
        raise DataError(
            f"what is seen spreads {ratio:.3g} times as far as the joints say. x and y must be in metres, joint angles "
            "in radians; or correct camera.px_per_m and arm.links."
        )


def refuse_fit(problem: Problem, fit: Fit) -> None:
    """Refuse a fit that is at an end of a range, leaves more than noise, or tells too
    little. Raises DataError.
    """
    low, high = problem.ranges(fit.names)
    for name, value, least, most in zip(fit.names, fit.x, low, high, strict=True):
        if value > most - EDGE * (most - least) or (
            least < 0 and value < least + EDGE * (most - least)
        ):
            raise DataError(
                f"{name} would be {value:.3g} or beyond, where the search ends. Correct conf/camera or conf/arm first."
            )
    refuse_misfit(problem, fit)
    for name, (most, unit) in CERTAIN.items():
        reach = fit.reach[fit.names.index(name)]
        if reach > most:
            fastest = max(speed(problem.model.arm, trial) for trial in problem.trials)
            raise DataError(
                f"{name} would be known to +- {reach:.2g} {unit} only, {most:g} is needed: the hand reaches "
                f"{fastest:.2f} m/s. Swing it faster and further, or film it longer."
            )


def refuse_misfit(problem: Problem, fit: Fit) -> None:
    """Refuse a fit that leaves much more than noise, or more than noise with a pattern.
    Raises DataError.
    """
    size = robust(fit.residual)
    if size < VISIBLE:
        return

    # share of the weighted rest that each explains beyond the parameters that were
    # fitted
    root, shares = np.sqrt(fit.weight)[:, None], {}
    fixed, rest = root * fit.slope, root[:, 0] * fit.residual
    for words, columns in suspects(problem, fit):
        both = root * np.concatenate([fit.slope, columns], axis=1)
        left = [
            float(np.sum((rest - a @ np.linalg.lstsq(a, rest, rcond=None)[0]) ** 2))
            for a in (fixed, both)
        ]
        shares[words] = 1 - left[1] / max(left[0], 1e-300)
    words, share = max(shares.items(), key=lambda one: one[1])
    if size < MISFIT and share < MOSTLY:
        return
    named = f"It is mostly as if {words}: that explains {100 * share:.0f} % of it."
    raise DataError(
        f"what is left is {size:.1f} times what noise explains. "
        f"{named if share > LEFT else 'It goes with nothing that is known.'} Nothing is taken over."
    )


def suspects(problem: Problem, fit: Fit) -> Iterator[tuple[str, np.ndarray]]:
    """Causes that could explain a remaining residual, as sentences, with the residual's
    change under each, (N, K).
    """
    yield (
        "the joints turned more or less than they report",
        moved_by(problem, fit, "joint_gain", 1e-3),
    )
    yield "a joint had play at its reversals", moved_by(problem, fit, "backlash", 0.01)
    lens = problem.slopes(
        (*fit.names, "lens_distortion.radial"), np.append(fit.x, 0.0)
    )[:, -1:]
    yield (
        "the lens bent it, growing with the distance from the middle of the picture",
        lens,
    )
    lag = problem.slopes((*fit.names, "arm_lag.time_constant"), np.append(fit.x, 0.01))[
        :, -1:
    ]
    yield "the arm lagged, following its speed", lag
    links = np.concatenate([trial.sightings.link for trial in problem.trials])
    yield (
        "the outline lay beside the line from joint to joint",
        (links[:, None] == np.unique(links)).astype(float),
    )
    along = np.concatenate([trial.sightings.along for trial in problem.trials])
    for moment in np.quantile(problem.times, np.linspace(0.1, 0.9, 17)):
        late = (problem.times > moment)[:, None]
        yield f"camera or arm was knocked at {moment:.2f} s", along * late


def moved_by(problem: Problem, fit: Fit, name: str, size: float) -> np.ndarray:
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
            np.concatenate([trial.off(model, one)[0] for trial in problem.trials])
            for one in values
        ]
    )
    return np.asarray((off[1:] - off[0]).T / problem.sigma[:, None])
