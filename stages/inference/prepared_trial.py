"""A trial prepared for estimation: its motion, its measured points, its error model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.content_cache import ContentCache
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.initial_state import (
    estimate_initial_state,
    first_frame_kinematics,
)
from stringcast.stages.inference.noise import WHITE_NOISE, Noise
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.kept_results import content_digest
from stringcast.stages.model.engine.sampling import (
    interpolate_measurements,
    interpolate_shares,
)
from stringcast.stages.model.engine.simulate import StringMotion
from stringcast.stages.model.hand import (
    HandMotion,
    JointMotion,
    resample_hand_motion,
    resample_joint_motion,
)
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState

INITIAL_MODES = 6  # of the initial shape, and as many of the turning rate
MAX_BATCH_CANDIDATES = 128  # candidates simulated at once: limits the memory
TIP_TOLERANCE_M = 1e-3  # points within this of the outermost are the tip
MAX_KEPT_STARTS = 256  # initial states in the cache


@dataclass(frozen=True)
class PreparedTrial:
    """A trial with the motion that the arm reports and the measured points.

    Parameters
    ----------
    name
        Name of the trial.
    model
        Model of arm, string and camera.
    motion
        Joint angles or poses of the grasp.
    times
        Frame times with valid readings, (F,) [s].
    frame, s
        Frame index and arc length [m] of each measured point, (N,).
    points
        Measured points, (N, 2) [m].
    sigma
        Their standard deviations, (N,) [m].
    initial_state
        The state at the start of the trial, on the camera's clock; None if the string
        is at rest before the hand moves.
    turn
        The side of the hand on which the string is at rest (`equilibrium.hanging`).
    mode_amplitudes
        Amplitudes of modes (`initial_modes`) by which the state differs from that
        estimated from the first frames.
    noise
        The correlation of the points' noise.
    growth
        Relative sensitivity to the parameters at each frame, (F,); empty before it is
        computed.
    error_model
        The model of residuals over sigma.
    by_share
        Whether `s` is the share of the line's length in the frame, times the string's
        length: a line without marks does not show where the string is stretched.
    line_start
        Start of the line of each point, (N, 2) [m]; NaN if it was not measured. The
        line was read from there on, even if the hand is elsewhere.
    """

    name: str
    model: Model
    motion: JointMotion | HandMotion
    times: np.ndarray
    frame: np.ndarray
    s: np.ndarray
    points: np.ndarray
    sigma: np.ndarray
    initial_state: StringState | None = None
    turn: float = 0.0
    mode_amplitudes: np.ndarray = field(
        default_factory=lambda: np.zeros(2 * INITIAL_MODES)
    )
    noise: Noise = WHITE_NOISE
    growth: np.ndarray = field(default_factory=lambda: np.zeros(0))
    error_model: IndependentErrors | Discrepancy = field(
        default=UNIT_ERRORS, repr=False
    )
    by_share: bool = False
    line_start: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def discrepancy(self) -> Discrepancy:
        """The error model of a trial whose discrepancy is modelled."""
        assert isinstance(self.error_model, Discrepancy)
        return self.error_model

    @property
    def independent_errors(self) -> IndependentErrors:
        """The error model of a trial whose discrepancy is not modelled."""
        assert isinstance(self.error_model, IndependentErrors)
        return self.error_model

    @property
    def start(self) -> float:
        """Start time of its simulation [s]."""
        state = self.initial_state
        return float(self.motion.start if state is None else state.t)

    @property
    def is_tip(self) -> np.ndarray:
        """A mask of the points at the tip, (N,)."""
        return np.asarray(self.s > self.s.max() - TIP_TOLERANCE_M)

    @property
    def point_times(self) -> np.ndarray:
        """The time of each measured point, (N,) [s]."""
        return np.asarray(self.times[self.frame])

    def displacements_m(self, residual: np.ndarray) -> np.ndarray:
        """Convert residuals over sigma (2 N,) to displacements (N, 2) [m]."""
        displacements = residual.reshape(-1, 2) * self.sigma[:, None]
        return np.asarray(displacements)

    def tip_rms(self, at_tip: np.ndarray) -> np.ndarray:
        """Compute the root mean square displacement of the tip [m], (...).

        at_tip: displacements of the points at the tip over sigma, (..., 2 m).
        """
        sigma = self.sigma[self.is_tip, None]
        at_tip_m = at_tip.reshape(*at_tip.shape[:-1], len(sigma), 2) * sigma
        squares = np.sum(at_tip_m**2, axis=-1)
        return np.asarray(np.sqrt(np.mean(squares, axis=-1)))

    def simulate(self, values: np.ndarray) -> Iterator[tuple[slice, StringMotion]]:
        """Simulate candidates (C, P) at the frame times, chunk by chunk."""
        for first in range(0, len(values), MAX_BATCH_CANDIDATES):
            chunk = slice(first, min(first + MAX_BATCH_CANDIDATES, len(values)))
            start = self.initial_state
            if start is not None:
                start = start.for_candidates(chunk)
            motion = self.model.simulate_observation(
                self.motion,
                values[chunk],
                self.times,
                start,
                self.turn,
            )
            yield chunk, motion

    def sample_at_points(self, points: np.ndarray) -> np.ndarray:
        """Interpolate strings (C, F, n, 2) at the measured points, (C, N, 2) [m]."""
        string = self.model.string
        if self.by_share:
            share = self.s / string.length
            sampled = interpolate_shares(points, self.frame, share, self.line_start)
            return np.asarray(sampled)
        position = self.s / string.segment_length
        return np.asarray(interpolate_measurements(points, self.frame, position))

    def normalised_residuals(self, points: np.ndarray) -> np.ndarray:
        """Compute simulated (C, N, 2) minus measured points over sigma, (C, 2 N)."""
        # Flat rows take a fifth of the time of pairs of coordinates
        distance = points.reshape(len(points), -1) - self.points.ravel()
        distance /= np.repeat(self.sigma, 2)
        return np.asarray(distance)

    def mean_square_ratio(self, simulated: np.ndarray) -> float:
        """Compute the mean square residual over sigma of simulated points (N, 2).

        Unlike a distance, it is not dominated by frames that were read poorly.
        """
        residuals = self.normalised_residuals(simulated[None])
        return float(np.mean(residuals**2))

    @cached_property
    def simulation_digest(self) -> str:
        """A digest of all inputs of the points' simulation except the model."""
        start = [self.motion, self.initial_state, self.turn]
        length = self.model.string.segment_length
        places = [self.frame, self.s, np.array([self.by_share]), self.line_start]
        return content_digest([*start, self.times, *places, length])

    def shift_times(self, seconds: float) -> PreparedTrial:
        """Add an offset to the camera's times [s]."""
        times = self.times + seconds
        state = self.initial_state
        return replace(
            self,
            times=times,
            motion=self.motion.extended_until(float(times[-1])),
            initial_state=state and replace(state, t=state.t + seconds),
        )

    def cut_after(self, last: float) -> PreparedTrial:
        """Cut the trial after a time [s]."""
        return self.first_frames(int(np.searchsorted(self.times, last + 1e-9)))

    def first_frames(self, frames: int) -> PreparedTrial:
        """Cut the trial after a number of frames."""
        kept = self.select_points(self.frame < frames)
        return replace(kept, times=self.times[:frames], growth=self.growth[:frames])

    def select_points(self, kept: np.ndarray) -> PreparedTrial:
        """Select points by a mask (N,), and drop the error model of all points."""
        return replace(
            self,
            frame=self.frame[kept],
            s=self.s[kept],
            points=self.points[kept],
            sigma=self.sigma[kept],
            line_start=self.line_start[kept] if self.by_share else self.line_start,
            error_model=UNIT_ERRORS,
        )

    def mean_square_distances(self, simulated: np.ndarray) -> tuple[float, float]:
        """Compute mean square distances of simulated from measured points (N, 2).

        Returns those of all points and of the outermost points [m2].
        """
        squares = np.sum((simulated - self.points) ** 2, axis=-1)
        outermost = self.s == self.s.max()
        return float(squares.mean()), float(squares[outermost].mean())


_KEPT_STARTS: ContentCache[StringState] = ContentCache(MAX_KEPT_STARTS)


def with_model(
    trials: Sequence[PreparedTrial],
    model: Model,
) -> tuple[PreparedTrial, ...]:
    """Replace the model of trials."""
    return tuple(replace(trial, model=model) for trial in trials)


def prepare_trial(model: Model, observation: Observation) -> PreparedTrial:
    """Prepare one observation. Raises DataError if it cannot be used."""
    points = observation.valid_points
    finite = np.isfinite(points[["t", "s", "x", "y"]]).all(axis=1)
    points = points[finite].sort_values(["t", "s"], kind="stable")
    if points.empty:
        raise DataError(
            f"trial {observation.trial}",
            "no valid point of the string",
            "Look at its readings' reasons.",
        )
    times, frame = np.unique(points["t"].to_numpy(), return_inverse=True)
    sigma_is_known = "sigma" in points
    s = points["s"].to_numpy()
    xy = points[["x", "y"]].to_numpy()
    by_share = "by_share" in points and bool(points["by_share"].all())
    trial = PreparedTrial(
        name=observation.trial,
        model=model,
        motion=observed_motion(observation).extended_until(times[-1]),
        times=times,
        frame=frame,
        s=s,
        points=xy,
        sigma=points["sigma"].to_numpy() if sigma_is_known else np.ones(len(points)),
        by_share=by_share,
        line_start=find_line_starts(frame, s, xy) if by_share else np.zeros((0, 2)),
    )
    hand = trial.motion.actual_hand_motion(model.arm, ())
    if observation.starts_moving:
        start = _estimate_start(trial, hand, sigma_is_known)
        return replace(trial, initial_state=start, turn=_turn_from_hand(hand, start))
    if not _hand_points_up(hand):
        return trial
    try:
        start = _estimate_start(trial, hand, sigma_is_known)
    except DataError:  # the first frames do not show the side
        return trial
    return replace(trial, turn=_turn_from_hand(hand, start))


def find_line_starts(
    frame: np.ndarray, s: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Find the point (2,) at s = 0 in the frame of each point, (N, 2); NaN without one.

    frame, s: frame and arc length of points (N, 2) [m], sorted by both.
    """
    _, first, number = np.unique(frame, return_index=True, return_inverse=True)
    starts = np.where(s[first, None] == 0, points[first], np.nan)
    return np.asarray(starts[number])


def _estimate_start(
    trial: PreparedTrial,
    hand: HandMotion,
    sigma_is_known: bool,
) -> StringState:
    """Estimate the initial state of a trial from its first frames.

    States are cached because every stage prepares its trials again.
    """
    length = trial.model.string.length
    sigma = float(np.median(trial.sigma)) if sigma_is_known else None
    parts = (
        *(trial.times, trial.frame, trial.s, trial.points),
        *(hand.pose, hand.rate, np.array([hand.start, hand.tick])),
        np.array([length, np.nan if sigma is None else sigma]),
    )

    def estimate() -> StringState:
        seen = first_frame_kinematics(
            trial.times, trial.frame, trial.s, trial.points, sigma, length
        )
        return estimate_initial_state(hand, length, trial.times, seen)

    try:
        return _KEPT_STARTS.find_or_make(parts, estimate)
    except DataError as error:
        place = f"trial {trial.name}"
        raise DataError(place, error.fault, error.remedy) from error


def _turn_from_hand(hand: HandMotion, start: StringState) -> float:
    """Compute the angle from a hand that points up to the end of the string [rad].

    It is 0 for a hand that points down, whose string has only one side.
    """
    if not _hand_points_up(hand):
        return 0.0
    return float(start.angle[-1] - hand.pose[0, 0, 2])


def _hand_points_up(hand: HandMotion) -> bool:
    return bool(np.sin(hand.pose[0, 0, 2]) > 0)


def observed_motion(observation: Observation) -> JointMotion | HandMotion:
    """Read the motion that the arm reports: joint angles or poses of the grasp."""
    arm, grasp = observation.arm, observation.grasp
    if arm is not None:
        return resample_joint_motion(arm["t"].to_numpy(), arm[list(JOINTS)].to_numpy())
    if grasp is None:
        raise DataError(
            f"trial {observation.trial}",
            "neither joint angles nor grasp poses",
            "Add arm.parquet or grasp.parquet.",
        )
    pose = grasp[["x", "y", "theta"]].to_numpy()
    return resample_hand_motion(grasp["t"].to_numpy(), pose)
