"""Estimate of the arc lengths of points on a string that hangs at rest.

A limp string hangs straight below the hand. A stiff one leaves the hand in the hand's
direction, so that its points have larger arc lengths than distances from the hand. So a
heavy rod of unknown bending stiffness, grasp stiffness, set and arc lengths is fitted
to the points at rest in all trials.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from stringcast.stages.check.consistency.prediction import REFERENCE_LENGTH_M
from stringcast.stages.check.consistency.record import Measurements
from stringcast.stages.common import rms
from stringcast.stages.model.effects.rest_curvature import RestCurvature
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.polyline import step_lengths
from stringcast.stages.model.statics.equilibrium import hanging_shape
from stringcast.stages.model.string import PAPER_EFFECTS, String

MAX_TRIALS = 12
MAX_ROD_MISFIT = 0.05  # of the length: with a right pose of the hand it is less
MAX_REST_SPREAD = 0.03  # of the farthest point's distance from the hand
PLACE_ERROR_M = 1e-3  # of a point relative to the hand; nearer points are at the grasp
ROD_POINTS = 81
INEXTENSIBLE = 1e7  # [N/(m kg)]
# Logarithm of the rod's bending stiffness at 0.3 m and ten mass points [N m/(rad kg)],
# logarithm of the grasp's stiffness over it, and set from end to end [rad]: standard
# deviations of normal priors centred at zero, and bounds
PRIOR_DEVIATION = np.array([3.0, 3.0, 0.7])
LOWEST = np.array([-7.0, -6.0, -3.0])
HIGHEST = np.array([7.0, 6.0, 3.0])
START_LOG_STIFFNESS = (-3.0, 0.0, 2.0, 4.0)
ARC_LENGTH_BOUNDS = (0.3, 3.0)  # relative to those of a limp string
LENGTH_ERROR_M = 1e-4  # of a stated length
DIFFERENCE_STEP = 1e-6  # of logarithms, [rad], [m]


@dataclass(frozen=True)
class RestingPoints:
    """Points of a string at rest, in K trials.

    Attributes
    ----------
    names
        Names of the J points, the nearest to the hand first.
    hands
        Poses of the hand (K, 3): x, y [m], theta [rad].
    places
        Positions of the points relative to the hand (K, J, 2) [m]; NaN if not seen.
    trials
        Names of the trials.
    """

    names: tuple[str, ...]
    hands: np.ndarray
    places: np.ndarray
    trials: tuple[str, ...]

    @property
    def chords(self) -> np.ndarray:
        """Median length of the polyline from the hand to each point [m], (J,).

        They are the arc lengths of a limp string.
        """
        paths = []
        for places in self.places:
            seen = np.isfinite(places).all(axis=1)
            path = np.full(len(places), np.nan)
            path[seen] = step_lengths(np.vstack([np.zeros(2), places[seen]])).cumsum()
            paths.append(path)
        return np.nanmedian(paths, axis=0)


@dataclass(frozen=True)
class HangingString:
    """Arc lengths of points from the fit of a hanging rod.

    Attributes
    ----------
    arc_lengths
        Arc length of each point, from the hand outwards [m].
    distances
        Distances of the points from the fitted rod, (K, J) [m]; NaN if not seen.
    """

    arc_lengths: dict[str, float]
    distances: np.ndarray

    @property
    def length(self) -> float:
        """Arc length of the last point [m]."""
        return max(self.arc_lengths.values())

    @property
    def misfit_m(self) -> float:
        """Root mean square distance of the points from the fitted rod [m]."""
        return rms(self.distances[np.isfinite(self.distances)])

    @property
    def is_rod(self) -> bool:
        """Whether the points are near enough to the rod to trust their arc lengths."""
        return self.misfit_m <= MAX_ROD_MISFIT * self.length


def find_resting_points(measured: Measurements) -> RestingPoints | None:
    """Find where points rest before the first motion, in trials that begin at rest.

    Returns None if a point was never seen at rest, or all are at the grasp.
    """
    resting = [r for r in measured.recordings if not r.starts_moving][:MAX_TRIALS]
    hands = [measured.pose(recording)[0] for recording in resting]
    unseen = np.full((len(resting), 2), np.nan)
    by_point: dict[str, np.ndarray] = {}
    for number, recording in enumerate(resting):
        from_hand = [track.rest_place - hands[number][:2] for track in recording.tracks]
        reach = np.linalg.norm(from_hand, axis=1).max()
        for track, place in zip(recording.tracks, from_hand, strict=True):
            in_each_trial = by_point.setdefault(track.point, unseen.copy())
            if track.rest_spread <= MAX_REST_SPREAD * reach:
                in_each_trial[number] = place
    if not by_point:
        return None
    places = np.stack([*by_point.values()], axis=1)  # (K, J, 2)
    if np.isnan(places).all(axis=(0, 2)).any():
        return None
    distances = np.nanmedian(np.linalg.norm(places, axis=-1), axis=0)
    if distances.max() < PLACE_ERROR_M:
        return None
    nearest_first = np.argsort(distances, kind="stable")
    names = [*by_point]
    ordered = tuple(names[point] for point in nearest_first)
    trials = tuple(recording.name for recording in resting)
    return RestingPoints(ordered, np.array(hands), places[:, nearest_first], trials)


def fit_hanging_string(resting: RestingPoints, length: float | None) -> HangingString:
    """Fit a heavy rod and the arc lengths of points to their places at rest.

    length: arc length of the last point [m]; None if it is unknown, too.
    """
    chords = resting.chords
    rod = HeavyRod.in_hands(resting.hands, resting.places[:, -1], float(chords[-1]))

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        """Compute least-squares residuals (C, R) of unknowns (C, 3 + J)."""
        stiffness_and_set, arc_lengths = np.split(unknowns, [3], axis=1)
        prior = stiffness_and_set / PRIOR_DEVIATION
        distances = rod.places(stiffness_and_set, arc_lengths) - resting.places
        errors = np.nan_to_num(distances) / PLACE_ERROR_M
        parts = [prior, errors.reshape(len(unknowns), -1)]
        if length is not None:
            parts.append((arc_lengths[:, -1:] - length) / LENGTH_ERROR_M)
        return np.concatenate(parts, axis=1)

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        """Compute finite-difference slopes of the residuals, (R, 3 + J), in a batch."""
        moved = unknowns + DIFFERENCE_STEP * np.eye(len(unknowns))
        at_unknowns, *at_moved = residuals(np.vstack([unknowns, moved]))
        return np.transpose(at_moved - at_unknowns) / DIFFERENCE_STEP

    start_lengths = chords * (length or chords[-1]) / chords[-1]
    shortest, longest = np.outer(ARC_LENGTH_BOUNDS, start_lengths)
    # Keep the bounds apart for a point at the grasp
    shortest = np.maximum(shortest - PLACE_ERROR_M, 0.0)
    longest = longest + PLACE_ERROR_M
    low = np.concatenate([LOWEST, shortest])
    high = np.concatenate([HIGHEST, longest])
    fits = []
    for log_stiffness in START_LOG_STIFFNESS:
        start = np.concatenate([[log_stiffness, 0.0, 0.0], start_lengths])
        fits.append(
            least_squares(
                lambda unknowns: residuals(unknowns[None])[0],
                start,
                slopes,
                bounds=(low, high),
            )
        )
    best = min(fits, key=lambda fit: float(fit.cost)).x

    (places,) = rod.places(best[None, :3], best[None, 3:])
    distances = np.linalg.norm(places - resting.places, axis=-1)
    # The rod ends at the last point: points beyond it were fitted to its end
    on_string = np.minimum(best[3:], best[-1])
    arc_lengths = on_string * (length or best[-1]) / best[-1]
    by_point = dict(zip(resting.names, map(float, arc_lengths), strict=True))
    return HangingString(by_point, distances)


@dataclass(frozen=True)
class HeavyRod:
    """A rod that hangs at rest from hands.

    Attributes
    ----------
    string
        A string of any length, because shapes scale with it.
    hands
        Poses (K, 3): x, y [m], theta [rad].
    turns
        Approximate angle from each hand to the rod's end, (K,) [rad].
    """

    string: String
    hands: np.ndarray
    turns: np.ndarray

    @classmethod
    def in_hands(cls, hands: np.ndarray, ends: np.ndarray, length: float) -> HeavyRod:
        """Hang a rod of about a length so that it ends near places (K, 2) [m]."""
        string = String(
            length,
            points=ROD_POINTS,
            tip_cell=0.5,
            grasp_cell=0.5,
            effects=(*PAPER_EFFECTS, RestCurvature),
        )
        directions = np.arctan2(ends[:, 1], ends[:, 0])
        turns = np.angle(np.exp(1j * (directions - hands[:, 2])))
        return cls(string, hands, np.nan_to_num(turns))

    def places(
        self, stiffness_and_set: np.ndarray, arc_lengths: np.ndarray
    ) -> np.ndarray:
        """Compute places of points at rest relative to the hands, (C, K, J, 2) [m].

        stiffness_and_set: as in PRIOR_DEVIATION, (C, 3). arc_lengths: (C, J) [m], that
        of the end last.
        """
        count, hands = len(arc_lengths), len(self.hands)
        angles, lengths = hanging_shape(
            self.string,
            np.repeat(self._material(stiffness_and_set), hands, axis=0),
            np.tile(self.hands, (count, 1)),
            np.tile(self.turns, count),
        )
        steps = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * lengths[..., None]
        nodes = np.insert(steps.cumsum(axis=1), 0, 0.0, axis=1)  # (C K, N, 2)
        shares = arc_lengths / arc_lengths[:, -1:]
        node_shares = np.linspace(0.0, 1.0, nodes.shape[1])
        places = []
        for share, curve in zip(np.repeat(shares, hands, axis=0), nodes, strict=True):
            places.append(interpolate_rows(share, node_shares, curve))
        by_candidate = np.reshape(places, (count, hands, -1, 2))
        scale = arc_lengths[:, -1] / self.string.length
        return scale[:, None, None, None] * by_candidate

    def _material(self, stiffness_and_set: np.ndarray) -> np.ndarray:
        """Compute material properties of candidates (C, 3), a row for each."""
        log_bending, log_ratio, set_angle = stiffness_and_set.T
        length = self.string.length
        bending = np.exp(log_bending) * length / REFERENCE_LENGTH_M
        values = {
            p.name: np.full(len(bending), p.start) for p in self.string.parameters
        }
        values |= {
            "axial_stiffness": np.full(len(bending), INEXTENSIBLE),
            "bending_stiffness": bending,
            "grasp_stiffness": bending * np.exp(log_ratio),
            "rest_curvature.curvature": set_angle / length,
        }
        return self.string.material(np.column_stack([*values.values()]))
