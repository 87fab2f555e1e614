"""What estimation asks of the forward model: candidates' strings at a trial's frame
times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.initial_state import (
    estimate_initial_state,
    first_frame_kinematics,
)
from stringcast.stages.inference.noise import WHITE_NOISE, Noise
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.model.engine.sampling import interpolate_measurements
from stringcast.stages.model.engine.simulate import StringMotion
from stringcast.stages.model.hand import (
    HandMotion,
    JointMotion,
    resample_hand_motion,
    resample_joint_motion,
)
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState

INITIAL_MODES = 6  # of a trial's initial state, in shape and in turning rate each
# candidates simulated at once: keeps memory in hand, whatever their number
MAX_BATCH_CANDIDATES = 128
TIP_TOLERANCE_M = 1e-3  # [m] points so near to the outermost are the tip


@dataclass(frozen=True)
class PreparedTrial:
    """One trial made ready: the motion as the arm reports it, and what was measured.

    times: (F,) frame times [s] with valid readings. points: (N, 2) measured [m] at
    frame index `frame` (N,) and arc length `s` (N,); sigma: (N,) [m]. initial: the
    state in which the trial begins, by the camera's clock; None if at rest before the
    hand moves. turn: on which side of the hand it is at rest, as of
    `equilibrium.hanging`. change: how far the state is from what the first frames say,
    in modes (`initial_modes`). noise: how the points' is correlated. error_model: what
    residuals are beyond that.
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
    error_model: IndependentErrors | Discrepancy = field(
        default=UNIT_ERRORS, repr=False
    )

    @property
    def discrepancy(self) -> Discrepancy:
        """The error model of a trial whose discrepancy is modelled."""
        assert isinstance(self.error_model, Discrepancy)
        return self.error_model

    @property
    def is_tip(self) -> np.ndarray:
        """Which of the points are the tip, (N,)."""
        return np.asarray(self.s > self.s.max() - TIP_TOLERANCE_M)

    def simulate(self, values: np.ndarray) -> Iterator[tuple[slice, StringMotion]]:
        """Strings of candidates (C, P) as the camera reports them at the frame times,
        chunk by chunk.
        """
        for first in range(0, len(values), MAX_BATCH_CANDIDATES):
            some = slice(first, min(first + MAX_BATCH_CANDIDATES, len(values)))
            begin = (
                None
                if self.initial_state is None
                else self.initial_state.for_candidates(some)
            )
            yield (
                some,
                self.model.simulate_observation(
                    self.motion, values[some], self.times, begin, self.turn
                ),
            )

    def sample_at_points(self, points: np.ndarray) -> np.ndarray:
        """Where strings (C, F, n, 2) are at the measured arc lengths and times, (C, N,
        2) [m].
        """
        return interpolate_measurements(
            points, self.frame, self.s / self.model.string.segment_length
        )

    def cut_after(self, last: float) -> PreparedTrial:
        """The first part of the trial, to this time [s]."""
        return self.first_frames(int(np.searchsorted(self.times, last + 1e-9)))

    def first_frames(self, frames: int) -> PreparedTrial:
        """So many of its frames, the first."""
        return replace(
            self.select_points(self.frame < frames), times=self.times[:frames]
        )

    def select_points(self, kept: np.ndarray) -> PreparedTrial:
        """Select points (N,). An error model is that of a whole trial, and is dropped."""
        parts = {
            name: getattr(self, name)[kept]
            for name in ("frame", "s", "points", "sigma")
        }
        return replace(self, **parts, error_model=UNIT_ERRORS)

    def mean_square_distances(self, values: np.ndarray) -> tuple[float, float]:
        """Mean square distance of one candidate (P,) from the measured points, and from
        those nearest the tip [m2].
        """
        _, motion = next(self.simulate(values[None]))
        squares = np.sum(
            (self.sample_at_points(motion.points)[0] - self.points) ** 2, axis=-1
        )
        return float(squares.mean()), float(squares[self.s == self.s.max()].mean())


def prepare_trial(model: Model, observation: Observation) -> PreparedTrial:
    """Make one observation ready; raises DataError where it cannot be used."""
    points = observation.valid_points
    points = points[np.isfinite(points[["t", "s", "x", "y"]]).all(axis=1)].sort_values(
        ["t", "s"], kind="stable"
    )
    if points.empty:
        raise DataError(
            f"trial {observation.trial}: no valid point of the string. Look at its readings' reasons."
        )
    times, frame = np.unique(points["t"].to_numpy(), return_inverse=True)
    sigma = points["sigma"].to_numpy() if "sigma" in points else np.ones(len(points))
    position = points[["x", "y"]].to_numpy()
    s, motion = (
        points["s"].to_numpy(),
        observed_motion(observation).extended_until(times[-1]),
    )
    ready = PreparedTrial(
        observation.trial, model, motion, times, frame, s, position, sigma
    )
    hand, known = motion.actual_hand_motion(model.arm, ()), "sigma" in points
    if observation.starts_moving:
        begun = _estimate_start(ready, hand, known)
        return replace(ready, initial_state=begun, turn=_turn_from_hand(hand, begun))
    try:
        return (
            replace(
                ready, turn=_turn_from_hand(hand, _estimate_start(ready, hand, known))
            )
            if _hand_points_up(hand)
            else ready
        )
    except DataError:  # the first frames do not show it
        return ready


def _estimate_start(ready: PreparedTrial, hand: HandMotion, known: bool) -> StringState:
    """The state in which a trial begins. known: the points' sigma is."""
    length = ready.model.string.length
    first = (ready.times, ready.frame, ready.s, ready.points)
    try:
        seen = first_frame_kinematics(
            *first, float(np.median(ready.sigma)) if known else None, length
        )
    except DataError as error:
        raise DataError(f"trial {ready.name}: {error}") from error
    return estimate_initial_state(hand, length, ready.times, seen)


def _turn_from_hand(hand: HandMotion, begun: StringState) -> float:
    """How far the string turns from a hand that points up to its end [rad]; 0 where the
    hand points down, from where there is one way.
    """
    return float(begun.angle[-1] - hand.pose[0, 0, 2]) if _hand_points_up(hand) else 0.0


def _hand_points_up(hand: HandMotion) -> bool:
    return bool(np.sin(hand.pose[0, 0, 2]) > 0)


def observed_motion(observation: Observation) -> JointMotion | HandMotion:
    """The motion as the arm reports it: joint angles or poses of the grasp."""
    if observation.arm is not None:
        return resample_joint_motion(
            observation.arm["t"].to_numpy(), observation.arm[list(JOINTS)].to_numpy()
        )
    if observation.grasp is None:
        raise DataError(
            f"trial {observation.trial}: neither joint angles nor grasp poses. Add arm.parquet or grasp.parquet."
        )
    return resample_hand_motion(
        observation.grasp["t"].to_numpy(),
        observation.grasp[["x", "y", "theta"]].to_numpy(),
    )
