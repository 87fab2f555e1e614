"""From the first frames of a trial to the state in which the string begins.

Each measured place moves along a parabola for a while: fitted to it, the first frames
give where it is and how fast it moves at the first. The string is then a curve hung
from the grasp that bends as little as the noise allows, and turns as evenly: direction
and turning rate are random walks along it, of the size that makes the measurement most
likely (MacKay 1992, Neural Computation 4, 415). At rest is a walk of no size, and holds
until the data speak clearly against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.common import points_at_arc_lengths
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.state import StringState

CURVE_PIECES = 40  # straight pieces of the curve
# to which parabolas are fitted: more are no parabola at 30 Hz, and at 200 Hz no better
PARABOLA_FRAMES = 4
# of the length: a place so far from what a frame shows was not seen in it
MAX_GAP_SHARE = 0.05
OUTLIER_RATIO = 5.0  # times the usual residual: a place beyond that has an outlier
MIN_NOISE_SHARE = 3e-4  # of the length: no place is known better
DIRECTION_WANDERS_RAD = np.geomspace(
    0.03, 10.0, 12
)  # [rad] by which the direction wanders over the length
RATE_WANDERS_RAD_S = np.geomspace(0.1, 100.0, 12)  # [rad/s] by which its rate does
HINGE_SHARES = (
    0.0,
    1.0,
)  # the same at the grasp alone, as shares of those: clamped, or loose
MIN_GAIN_LOG_EVIDENCE = 3.0  # gain in log evidence from which the string moves: 20 to 1
GAUSS_NEWTON_STEPS = 12  # of Gauss-Newton to the shape
# of the line that they begin with: nearer places are as far apart by noise as along the
# string
INITIAL_CORNERS = 10


@dataclass(frozen=True)
class Kinematics:
    """Where measured places are at the first frame and how fast they move.

    s: (M,) arc lengths [m]. place: (M, 2) [m]. velocity: (M, 2) [m/s]. Their standard
    deviations, (M,) each.
    """

    s: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    place_sigma: np.ndarray
    velocity_sigma: np.ndarray


def estimate_initial_state(
    hand: HandMotion, length: float, times: np.ndarray, seen: Kinematics
) -> StringState:
    """The state at the first of the frames. length: of the string [m]. times: (F,) [s].
    hand: as the arm reports it.
    """
    first = hand.starting_at(float(times[0]))
    pose, rate = first.pose[0, 0], first.rate[0, 0]
    angle = _fit_shape(seen, pose, length)
    middle = (np.arange(CURVE_PIECES) + 0.5) * length / CURVE_PIECES
    return StringState(
        float(times[0]), middle, angle, _fit_turning_rates(seen, angle, rate, length)
    )


def first_frame_kinematics(
    times: np.ndarray,
    frame: np.ndarray,
    s: np.ndarray,
    points: np.ndarray,
    sigma: float | None,
    length: float,
) -> Kinematics:
    """Places and velocities at the first of the frames. Raises DataError where they are
    too few.

    times: (F,) [s]. points: (N, 2) measured [m] at frame index `frame` (N,) and arc
    length `s` (N,) [m]. sigma: one standard deviation of a point [m], None if unknown:
    the least that is assumed, for the scatter tells too.
    """
    tracks, places = _early_tracks(frame, s, points, length)
    usual = np.isfinite(tracks[..., 0]).sum(axis=0) >= 3
    if not np.any(places[usual] > 0):
        raise DataError(
            f"it begins moving, but no place on the string is seen in 3 of its first {PARABOLA_FRAMES} frames. Begin it where "
            "the string is seen, or say 'initial: rest' in dataset.yaml."
        )
    fitted, spread, left = _fit_parabolas(
        times[: len(tracks)] - times[0], tracks[:, usual]
    )
    least = max(sigma or 0.0, MIN_NOISE_SHARE * length)
    sound = left <= OUTLIER_RATIO * max(float(np.median(left)), least)
    noise = max(float(np.sqrt(np.mean(left[sound] ** 2))), least)
    place, velocity, *_ = fitted[sound].transpose(1, 0, 2)
    return Kinematics(
        places[usual][sound], place, velocity, *noise * spread[sound, :2].T
    )


def _early_tracks(
    frame: np.ndarray, s: np.ndarray, points: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places through the first frames, (F, M, 2) [m], NaN where not seen, and their arc
    lengths (M,) [m].

    They are those of the fullest of these frames; between its points a frame is
    interpolated.
    """
    early = frame < PARABOLA_FRAMES
    frame, s = frame[early], s[early]
    places = s[frame == np.argmax(np.bincount(frame))]
    tracks = points_at_arc_lengths(frame, s, points[early], places)
    for number, track in enumerate(tracks):
        far = (
            np.abs(places[:, None] - s[frame == number]).min(axis=1)
            >= MAX_GAP_SHARE * length
        )
        track[far] = np.nan
    return tracks, places


def _fit_parabolas(
    t: np.ndarray, tracks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parabolas through each place: coefficients (M, 3, 2), their standard deviations
    per noise (M, 3), and the noise (M,) that each leaves [m].
    """
    powers = np.vander(t / t[-1], 3, increasing=True)
    coefficients, spread = (
        np.empty((tracks.shape[1], 3, 2)),
        np.empty((tracks.shape[1], 3)),
    )
    left = np.empty(tracks.shape[1])
    for place, track in enumerate(tracks.transpose(1, 0, 2)):
        there = np.isfinite(track[:, 0])
        inverse = np.linalg.pinv(powers[there])
        coefficients[place] = inverse @ track[there]
        spread[place] = np.linalg.norm(inverse, axis=1)
        residual = track[there] - powers[there] @ coefficients[place]
        left[place] = np.linalg.norm(residual) / np.sqrt(2 * max(there.sum() - 3, 1))
    scale = t[-1] ** np.arange(3)
    return coefficients / scale[:, None], spread / scale, left


def _fit_shape(seen: Kinematics, pose: np.ndarray, length: float) -> np.ndarray:
    """Directions of the curve's pieces (PIECES,) [rad], continuous from the grasp's.
    pose: (3,).
    """
    start = _straight_line_angles(seen, pose, length)
    fits = []
    for turn, hinge in product(DIRECTION_WANDERS_RAD, HINGE_SHARES):
        angle = start
        for _ in range(GAUSS_NEWTON_STEPS):
            slope = _place_slopes(seen.s, angle, length)
            line = pose[:2] + _length_before(seen.s, length) @ np.stack(
                [np.cos(angle), np.sin(angle)], axis=-1
            )
            offset = (seen.place - line).ravel() + slope @ (angle - pose[2])
            change, evidence = _random_walk_posterior(
                slope, offset, seen.place_sigma, turn, hinge
            )
            angle = pose[2] + change
        fits.append((evidence, angle))
    return max(fits, key=lambda fit: fit[0])[1]


def _straight_line_angles(
    seen: Kinematics, pose: np.ndarray, length: float
) -> np.ndarray:
    """Directions (PIECES,) [rad] of the straight lines from the grasp by way of a few
    places.
    """
    away = np.flatnonzero(seen.s > 1e-9 * length)
    evenly = np.linspace(0.0, seen.s[-1], INITIAL_CORNERS + 1)[1:]
    corners = np.unique(away[np.abs(seen.s[away] - evenly[:, None]).argmin(axis=1)])
    line = np.concatenate([pose[None, :2], seen.place[corners]])
    ends = np.concatenate([[0.0], seen.s[corners]])
    step = np.diff(line, axis=0)
    angles = np.unwrap(np.concatenate([pose[2:], np.arctan2(step[:, 1], step[:, 0])]))[
        1:
    ]
    return np.interp(
        (np.arange(CURVE_PIECES) + 0.5) * length / CURVE_PIECES,
        (ends[1:] + ends[:-1]) / 2,
        angles,
    )


def _fit_turning_rates(
    seen: Kinematics, angle: np.ndarray, rate: np.ndarray, length: float
) -> np.ndarray:
    """Rates (PIECES,) [rad/s] at which directions `angle` turn; as with the hand where
    no more is to be seen.
    """
    slope = _place_slopes(seen.s, angle, length)
    offset = (seen.velocity - rate[:2]).ravel() - slope @ np.full(CURVE_PIECES, rate[2])
    rest, at_rest = _random_walk_posterior(slope, offset, seen.velocity_sigma, 0.0, 0.0)
    fits = [
        _random_walk_posterior(slope, offset, seen.velocity_sigma, size, hinge)
        for size, hinge in product(RATE_WANDERS_RAD_S, HINGE_SHARES)
    ]
    change, evidence = max(fits, key=lambda fit: fit[1])
    return rate[2] + (change if evidence > at_rest + MIN_GAIN_LOG_EVIDENCE else rest)


def _random_walk_posterior(
    slope: np.ndarray, offset: np.ndarray, sigma: np.ndarray, size: float, hinge: float
) -> tuple[np.ndarray, float]:
    """Mean of a random walk along the curve, given what it has caused, and the log of
    how likely that is.

    slope: (2 M, PIECES) of what is measured, offset (2 M,), with the walk. sigma: (M,).
    size: standard deviation of the walk over the whole curve, and hinge its share at
    the grasp. Returns (PIECES,).
    """
    steps = np.full(CURVE_PIECES, 1 / CURVE_PIECES)
    steps[0] = 0.5 / CURVE_PIECES + hinge**2
    sums = np.cumsum(steps)
    prior = size**2 * np.minimum.outer(sums, sums)
    covariance = slope @ prior @ slope.T + np.diag(np.repeat(sigma, 2) ** 2)
    pull = np.linalg.solve(covariance, offset)
    return prior @ slope.T @ pull, float(
        -0.5 * (offset @ pull + np.linalg.slogdet(covariance)[1])
    )


def _length_before(s: np.ndarray, length: float) -> np.ndarray:
    """How much of each piece lies before each place, (M, PIECES) [m]."""
    piece = length / CURVE_PIECES
    lever = np.clip(s[:, None] - piece * np.arange(CURVE_PIECES), 0.0, piece)
    lever[:, -1] += np.maximum(s - length, 0.0)
    return lever


def _place_slopes(s: np.ndarray, angle: np.ndarray, length: float) -> np.ndarray:
    """How places move as the pieces turn, (2 M, PIECES) [m/rad]."""
    across = np.stack([-np.sin(angle), np.cos(angle)])
    return (_length_before(s, length)[:, None] * across).reshape(-1, CURVE_PIECES)
