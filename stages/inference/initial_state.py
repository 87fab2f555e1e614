"""The initial state of a string from the first frames of a trial.

A parabola in time is fitted to each measured place, which gives its position and its
velocity at the first frame. Then a curve from the grasp is fitted to them, whose
directions and turning rates are random walks along the string. The size of each walk
has the highest evidence. The string is taken to be at rest (a walk of size zero) unless
the evidence is clearly against it.

References
----------
MacKay 1992, Neural Computation 4, 415.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.common import rms
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.state import StringState
from stringcast.stages.string_places import points_at_arc_lengths

CURVE_PIECES = 40  # straight pieces of the curve
PARABOLA_FRAMES = 4  # at 30 Hz, more do not fit a parabola; at 200 Hz, more do not help
MAX_GAP_SHARE = 0.05  # of the length: a place farther from a frame's points is not seen
OUTLIER_RATIO = 5.0  # relative to the median residual of places
MIN_NOISE_SHARE = 3e-4  # of the length: least standard deviation of a place

# Standard deviations over the whole length that are tried for the random walks
DIRECTION_WANDERS_RAD = np.geomspace(0.03, 10.0, 12)
RATE_WANDERS_RAD_S = np.geomspace(0.1, 100.0, 12)
HINGE_SHARES = (0.0, 1.0)  # step at the grasp over the wander: clamped or loose

MIN_GAIN_LOG_EVIDENCE = 3.0  # for a string that moves: 20 to 1
GAUSS_NEWTON_STEPS = 12  # for the shape
INITIAL_CORNERS = 10  # of the initial line; more would follow the noise


@dataclass(frozen=True)
class Kinematics:
    """Positions and velocities of measured places at the first frame.

    Parameters
    ----------
    s
        Arc lengths of the places, (M,) [m].
    position
        Positions, (M, 2) [m].
    velocity
        Velocities, (M, 2) [m/s].
    position_sigma, velocity_sigma
        Their standard deviations, (M,).
    """

    s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    position_sigma: np.ndarray
    velocity_sigma: np.ndarray


def estimate_initial_state(
    hand: HandMotion,
    length: float,
    times: np.ndarray,
    measured: Kinematics,
) -> StringState:
    """Fit shape and turning rates of the string at the first frame.

    Parameters
    ----------
    hand
        The hand's motion as the arm reports it.
    length
        Length of the string [m].
    times
        Frame times, (F,) [s].
    measured
        Places and their velocities at the first frame.
    """
    start = float(times[0])
    moved = hand.starting_at(start)
    angle = _fit_shape(measured, moved.pose[0, 0], length)
    rates = _fit_turning_rates(measured, angle, moved.rate[0, 0], length)
    return StringState(start, _piece_middles(length), angle, rates)


def first_frame_kinematics(
    times: np.ndarray,
    frame: np.ndarray,
    s: np.ndarray,
    points: np.ndarray,
    sigma: float | None,
    length: float,
) -> Kinematics:
    """Estimate positions and velocities at the first frame.

    Parameters
    ----------
    times
        Frame times, (F,) [s].
    frame, s, points
        Frame index (N,), arc length (N,) [m] and position (N, 2) [m] of each measured
        point.
    sigma
        Standard deviation of a point [m], None if unknown. The noise is estimated from
        the scatter, but is at least this.
    length
        Length of the string [m].

    Raises
    ------
    DataError
        If no place is seen in three of the first frames.
    """
    tracks, places = _early_tracks(frame, s, points, length)
    usable = np.isfinite(tracks[..., 0]).sum(axis=0) >= 3
    if not np.any(places[usable] > 0):
        raise DataError(
            "",
            "it begins moving, but no place on the string is seen in 3 of its "
            f"first {PARABOLA_FRAMES} frames",
            "Begin it where the string is seen, or say 'initial: rest' in "
            "dataset.yaml.",
        )
    early_times = times[: len(tracks)] - times[0]
    parabolas, spread, residual = _fit_parabolas(early_times, tracks[:, usable])

    least_noise = max(sigma or 0.0, MIN_NOISE_SHARE * length)
    typical = max(float(np.median(residual)), least_noise)
    sound = residual <= OUTLIER_RATIO * typical
    noise = max(rms(residual[sound]), least_noise)

    position, velocity, _ = parabolas[sound].transpose(1, 0, 2)
    position_sigma, velocity_sigma = noise * spread[sound, :2].T
    s = places[usable][sound]
    return Kinematics(s, position, velocity, position_sigma, velocity_sigma)


def _early_tracks(
    frame: np.ndarray,
    s: np.ndarray,
    points: np.ndarray,
    length: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Follow places through the first frames, (F, M, 2) [m], NaN where not seen.

    The places, arc lengths (M,) [m], are those of the frame with the most points. Other
    frames are interpolated between their points.
    """
    early = frame < PARABOLA_FRAMES
    frame = frame[early]
    s = s[early]
    fullest = np.argmax(np.bincount(frame))
    places = s[frame == fullest]
    tracks = points_at_arc_lengths(frame, s, points[early], places)
    for number, track in enumerate(tracks):
        gaps = np.abs(places[:, None] - s[frame == number])
        track[gaps.min(axis=1) >= MAX_GAP_SHARE * length] = np.nan
    return tracks, places


def _fit_parabolas(
    t: np.ndarray,
    tracks: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit a parabola to each place.

    Returns coefficients (M, 3, 2), their standard deviations per noise (M, 3), and the
    root mean square residual (M,) [m].
    """
    powers = np.vander(t / t[-1], 3, increasing=True)  # (F, 3)
    coefficients = []
    spread = []
    residual_rms = []
    for track in tracks.transpose(1, 0, 2):
        seen = np.isfinite(track[:, 0])
        inverse = np.linalg.pinv(powers[seen])
        parabola = inverse @ track[seen]
        residual = track[seen] - powers[seen] @ parabola
        degrees = 2 * max(seen.sum() - 3, 1)
        coefficients.append(parabola)
        spread.append(np.linalg.norm(inverse, axis=1))
        residual_rms.append(np.linalg.norm(residual) / np.sqrt(degrees))
    scale = t[-1] ** np.arange(3)
    return (
        np.array(coefficients) / scale[:, None],
        np.array(spread) / scale,
        np.array(residual_rms),
    )


def _fit_shape(measured: Kinematics, pose: np.ndarray, length: float) -> np.ndarray:
    """Fit the directions of the curve's pieces, (PIECES,) [rad], by Gauss-Newton.

    They continue the direction of the grasp without jumps by 2 pi. pose: (3,), of the
    grasp.
    """
    start = _straight_line_angles(measured, pose, length)
    before = _length_before(measured.s, length)
    best = start
    highest = -np.inf
    for wander, hinge in product(DIRECTION_WANDERS_RAD, HINGE_SHARES):
        angle = start
        for _ in range(GAUSS_NEWTON_STEPS):
            slope = _place_slopes(measured.s, angle, length)
            directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            curve = pose[:2] + before @ directions
            offset = (measured.position - curve).ravel() + slope @ (angle - pose[2])
            walk, evidence = _random_walk_posterior(
                slope,
                offset,
                measured.position_sigma,
                wander,
                hinge,
            )
            angle = pose[2] + walk
        if evidence > highest:
            best = angle
            highest = evidence
    return best


def _straight_line_angles(
    measured: Kinematics,
    pose: np.ndarray,
    length: float,
) -> np.ndarray:
    """Compute directions (PIECES,) [rad] of a line from the grasp through places."""
    beyond_grasp = np.flatnonzero(measured.s > 1e-9 * length)
    wanted = np.linspace(0.0, measured.s[-1], INITIAL_CORNERS + 1)[1:]
    gap = np.abs(measured.s[beyond_grasp] - wanted[:, None])
    corners = np.unique(beyond_grasp[gap.argmin(axis=1)])

    line = np.concatenate([pose[None, :2], measured.position[corners]])
    step = np.diff(line, axis=0)
    directions = np.arctan2(step[:, 1], step[:, 0])
    angles = np.unwrap(np.concatenate([pose[2:], directions]))[1:]

    ends = np.concatenate([[0.0], measured.s[corners]])
    middles = (ends[1:] + ends[:-1]) / 2
    return np.asarray(np.interp(_piece_middles(length), middles, angles))


def _fit_turning_rates(
    measured: Kinematics,
    angle: np.ndarray,
    rate: np.ndarray,
    length: float,
) -> np.ndarray:
    """Fit the turning rates of the curve's pieces, (PIECES,) [rad/s].

    They are those of the hand unless the evidence for another motion is clear.
    rate: (3,), of the grasp's pose.
    """
    slope = _place_slopes(measured.s, angle, length)
    turning = slope @ np.full(CURVE_PIECES, rate[2])
    offset = (measured.velocity - rate[:2]).ravel() - turning
    sigma = measured.velocity_sigma
    best, at_rest = _random_walk_posterior(slope, offset, sigma, 0.0, 0.0)
    highest = at_rest + MIN_GAIN_LOG_EVIDENCE
    for wander, hinge in product(RATE_WANDERS_RAD_S, HINGE_SHARES):
        walk, evidence = _random_walk_posterior(slope, offset, sigma, wander, hinge)
        if evidence > highest:
            best = walk
            highest = evidence
    return np.asarray(rate[2] + best)


def _random_walk_posterior(
    slope: np.ndarray,
    offset: np.ndarray,
    sigma: np.ndarray,
    wander: float,
    hinge: float,
) -> tuple[np.ndarray, float]:
    """Compute the mean of a random walk along the curve, and its log evidence.

    Parameters
    ----------
    slope
        Derivatives of the measurements by the walk, (2 M, PIECES).
    offset
        Measurements, (2 M,).
    sigma
        Standard deviation of each place, (M,).
    wander
        Standard deviation of the walk over the whole curve.
    hinge
        Standard deviation of its step at the grasp, over `wander`.
    """
    steps = np.full(CURVE_PIECES, 1 / CURVE_PIECES)
    steps[0] = 0.5 / CURVE_PIECES + hinge**2
    sums = np.cumsum(steps)
    prior = wander**2 * np.minimum.outer(sums, sums)
    noise = np.diag(np.repeat(sigma, 2) ** 2)
    covariance = slope @ prior @ slope.T + noise
    pull = np.linalg.solve(covariance, offset)
    mean = prior @ slope.T @ pull
    log_determinant = np.linalg.slogdet(covariance)[1]
    return mean, float(-0.5 * (offset @ pull + log_determinant))


def _piece_middles(length: float) -> np.ndarray:
    return (np.arange(CURVE_PIECES) + 0.5) * length / CURVE_PIECES


def _length_before(s: np.ndarray, length: float) -> np.ndarray:
    """Compute the length of each piece before each place, (M, PIECES) [m]."""
    piece = length / CURVE_PIECES
    beginnings = piece * np.arange(CURVE_PIECES)
    before = np.clip(s[:, None] - beginnings, 0.0, piece)
    before[:, -1] += np.maximum(s - length, 0.0)
    return np.asarray(before)


def _place_slopes(s: np.ndarray, angle: np.ndarray, length: float) -> np.ndarray:
    """Compute derivatives of places by the pieces' angles, (2 M, PIECES) [m/rad]."""
    across = np.stack([-np.sin(angle), np.cos(angle)])
    slopes = _length_before(s, length)[:, None] * across
    return np.asarray(slopes.reshape(-1, CURVE_PIECES))
