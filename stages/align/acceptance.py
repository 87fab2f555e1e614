"""Refuse an alignment, with the reason."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.align.fit import AlignmentFit, AlignmentProblem, robust_sigma
from stringcast.stages.align.sightings import points_on_links
from stringcast.stages.model.effect import amplitude_parameters
from stringcast.stages.model.library import find_effects

MIN_FRAMES = 30  # that show the arm
MIN_HAND_SPEED = 0.1  # [m/s]; a slower hand does not determine the clock offset
MIN_SIGHTING_SPAN_M = 1e-3  # added to spreads, so that a resting arm has a ratio of 1
SCALE_RANGE = (0.7, 1.4)  # seen over expected spread
MAX_MISFIT = 3.0  # residuals over sigma
MAX_STRUCTURED_MISFIT = 1.5  # the same if the residuals have a pattern
MIN_PATTERN_SHARE = 0.5  # of the squared residuals, explained by a pattern
MIN_NAMED_SHARE = 0.2  # of the squared residuals, for a cause to be named
REQUIRED_PRECISION = {
    "time_offset.offset": (2e-3, "s"),
    "camera_rotation.angle": (0.02, "rad"),
    "pixel_scale.excess": (0.02, "1"),
}
RANGE_EDGE = 1e-3  # share of a range within which a parameter is at its end


def refuse_sight(problem: AlignmentProblem) -> None:
    """Raise DataError if the arm is hardly seen, hardly moves or has wrong units."""
    frames = sum(np.unique(trial.sightings.frame).size for trial in problem.trials)
    if frames < MIN_FRAMES:
        raise DataError(
            "",
            f"the arm is seen in {frames} frames only, {MIN_FRAMES} are needed",
            "Film it longer, or light it.",
        )
    if problem.max_hand_speed < MIN_HAND_SPEED:
        raise DataError(
            "",
            f"the hand moves at {problem.max_hand_speed:.3f} m/s at most: too "
            f"slow to compare clocks, {MIN_HAND_SPEED} m/s are needed",
            "Swing it.",
        )
    # seen over expected spread of the arm
    log_ratios = []
    values = problem.model.values({})[None]
    for trial in problem.trials:
        seen = trial.sightings
        joints = problem.model.observed_arm(trial.motion, values, seen.times)
        seen_span = _span(seen.position)
        expected_span = _span(points_on_links(joints, seen)[0])
        log_ratios.append(np.log(seen_span / expected_span))
    ratio = np.exp(np.median(log_ratios))
    if not SCALE_RANGE[0] < ratio < SCALE_RANGE[1]:
        raise DataError(
            "",
            f"the seen points spread {ratio:.3g} times as far as the joint "
            "angles imply. x and y must be in metres, joint angles in radians; "
            "or correct camera.px_per_m and arm.links",
        )


def _span(points: np.ndarray) -> float:
    return MIN_SIGHTING_SPAN_M + float(np.linalg.norm(np.ptp(points, axis=0)))


def refuse_fit(problem: AlignmentProblem, fit: AlignmentFit) -> None:
    """Raise DataError for a fit at a range's end, with misfit, or too imprecise."""
    low, high = problem.ranges(fit.names)
    edge = RANGE_EDGE * (high - low)
    is_at_end = (fit.x > high - edge) | ((low < 0) & (fit.x < low + edge))
    if is_at_end.any():
        place = int(np.argmax(is_at_end))
        raise DataError(
            "",
            f"{fit.names[place]} would be {fit.x[place]:.3g}, at the end of its range",
            "Correct conf/camera or conf/arm first.",
        )
    refuse_misfit(problem, fit)
    for name, (limit, unit) in REQUIRED_PRECISION.items():
        half_width = fit.half_widths[fit.names.index(name)]
        if half_width > limit:
            raise DataError(
                "",
                f"{name} would be known to +- {half_width:.2g} {unit} only, "
                f"{limit:g} is needed: the hand reaches "
                f"{problem.max_hand_speed:.2f} m/s",
                "Swing it faster and further, or film it longer.",
            )


def refuse_misfit(problem: AlignmentProblem, fit: AlignmentFit) -> None:
    """Raise DataError for residuals far above the noise, or above it with a pattern.

    The message names the likeliest cause.
    """
    misfit = robust_sigma(fit.residual)
    if misfit < MAX_STRUCTURED_MISFIT:
        return

    # share of the weighted residuals that each cause explains beyond the parameters
    root = np.sqrt(fit.weight)[:, None]
    residual = root[:, 0] * fit.residual
    unexplained = _residual_sum(root * fit.jacobian, residual)
    shares = {}
    for sentence, columns in suspected_causes(problem, fit):
        extended = root * np.concatenate([fit.jacobian, columns], axis=1)
        remaining = _residual_sum(extended, residual)
        shares[sentence] = 1 - remaining / max(unexplained, 1e-300)
    sentence, share = max(shares.items(), key=lambda item: item[1])
    if misfit < MAX_MISFIT and share < MIN_PATTERN_SHARE:
        return
    cause = "No known cause explains it."
    if share > MIN_NAMED_SHARE:
        cause = f"It looks as if {sentence}: this explains {100 * share:.0f} % of it."
    raise DataError(
        "",
        f"the misfit is {misfit:.1f} times the noise",
        f"{cause} No alignment is made.",
    )


def _residual_sum(jacobian: np.ndarray, residual: np.ndarray) -> float:
    """Return the residual sum of squares of linear least squares."""
    solution = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    return float(np.sum((residual - jacobian @ solution) ** 2))


def suspected_causes(
    problem: AlignmentProblem, fit: AlignmentFit
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield possible causes of a misfit, and their changes of the residuals (N, K)."""
    yield (
        "the joints turned more or less than they report",
        residual_changes(problem, fit, "joint_gain", 1e-3),
    )
    yield (
        "a joint had play at its reversals",
        residual_changes(problem, fit, "backlash", 0.01),
    )
    yield (
        "the lens distorted the picture, more with the distance from its centre",
        _added_column(problem, fit, "lens_distortion.radial", 0.0),
    )
    yield (
        "the arm lagged, in proportion to its speed",
        _added_column(problem, fit, "arm_lag.time_constant", 0.01),
    )
    links = np.concatenate([trial.sightings.link for trial in problem.trials])
    yield (
        "the outline was shifted sideways from the line between the joints",
        (links[:, None] == np.unique(links)).astype(float),
    )
    directions = np.concatenate([t.sightings.direction for t in problem.trials])
    for moment in np.quantile(problem.times, np.linspace(0.1, 0.9, 17)):
        is_later = (problem.times > moment)[:, None]
        yield f"camera or arm was knocked at {moment:.2f} s", directions * is_later


def _added_column(
    problem: AlignmentProblem, fit: AlignmentFit, name: str, value: float
) -> np.ndarray:
    """Return the Jacobian column of a further parameter at a value (N, 1)."""
    return problem.jacobian((*fit.names, name), np.append(fit.x, value))[:, -1:]


def residual_changes(
    problem: AlignmentProblem, fit: AlignmentFit, name: str, size: float
) -> np.ndarray:
    """Return changes of the residuals over sigma by an effect on the hand, (N, K).

    size: of each of its K amplitudes.
    """
    effect = find_effects([name])[0]
    model = problem.model.with_effects(effect)
    amplitudes = map(effect.qualified_name, amplitude_parameters(effect))
    settings = [fit.values, *(fit.values | {one: size} for one in amplitudes)]
    residuals = []
    for setting in settings:
        values = model.values(setting)[None]
        parts = [trial.residuals(model, values)[0] for trial in problem.trials]
        residuals.append(np.concatenate(parts))
    changes = np.stack(residuals[1:]) - residuals[0]
    return changes.T / problem.sigma[:, None]
