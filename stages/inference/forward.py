"""What estimation asks of the forward model: candidates' strings at a trial's frame times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from stringcast.data.artifacts import JOINTS, Observation
from stringcast.data.schema import DataError
from stringcast.stages.inference.discrepancy import Discrepancy
from stringcast.stages.inference.initial_state import initial_state, kinematics
from stringcast.stages.inference.noise import WHITE, Noise
from stringcast.stages.inference.whitening import UNIT_ERRORS, IndependentErrors
from stringcast.stages.model.hand import HandMotion, JointMotion, hand_motion_from_grasp, joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.sampling import measured
from stringcast.stages.model.simulate import StringMotion
from stringcast.stages.model.state import State

MODES = 6  # of a trial's initial state, in shape and in turning rate each
CHUNK = 128  # candidates simulated at once: keeps memory in hand, whatever their number
TIP = 1e-3  # [m] points so near to the outermost are the tip


@dataclass(frozen=True)
class Case:
    """One trial made ready: the motion as the arm reports it, and what was measured.

    times: (F,) frame times [s] with valid readings. points: (N, 2) measured [m] at frame
    index `frame` (N,) and arc length `s` (N,); sigma: (N,) [m]. initial: the state in which the
    trial begins, by the camera's clock; None if at rest before the hand moves. turn: on which side of the hand it is
    at rest, as of `equilibrium.hanging`. change: how far the state is from what the first frames say, in modes
    (`initial_modes`). noise: how the points' is correlated. error_model: what residuals are beyond that.
    """

    name: str
    model: Model
    motion: JointMotion | HandMotion
    times: np.ndarray
    frame: np.ndarray
    s: np.ndarray
    points: np.ndarray
    sigma: np.ndarray
    initial: State | None = None
    turn: float = 0.0
    change: np.ndarray = field(default_factory=lambda: np.zeros(2 * MODES))
    noise: Noise = WHITE
    error_model: IndependentErrors | Discrepancy = field(default=UNIT_ERRORS, repr=False)

    @property
    def discrepancy(self) -> Discrepancy:
        """The error model of a trial whose discrepancy is modelled."""
        assert isinstance(self.error_model, Discrepancy)
        return self.error_model

    @property
    def tip(self) -> np.ndarray:
        """Which of the points are the tip, (N,)."""
        return np.asarray(self.s > self.s.max() - TIP)

    def simulate(self, values: np.ndarray) -> Iterator[tuple[slice, StringMotion]]:
        """Strings of candidates (C, P) as the camera reports them at the frame times, chunk by chunk."""
        for first in range(0, len(values), CHUNK):
            some = slice(first, min(first + CHUNK, len(values)))
            begin = None if self.initial is None else self.initial.of(some)
            yield some, self.model.seen(self.motion, values[some], self.times, begin, self.turn)

    def at_measured(self, points: np.ndarray) -> np.ndarray:
        """Where strings (C, F, n, 2) are at the measured arc lengths and times, (C, N, 2) [m]."""
        return measured(points, self.frame, self.s / self.model.string.segment)

    def until(self, last: float) -> Case:
        """The first part of the trial, to this time [s]."""
        return self.first(int(np.searchsorted(self.times, last + 1e-9)))

    def first(self, frames: int) -> Case:
        """So many of its frames, the first."""
        return replace(self.only(self.frame < frames), times=self.times[:frames])

    def only(self, kept: np.ndarray) -> Case:
        """Select points (N,). An error model is that of a whole trial, and is dropped."""
        parts = {name: getattr(self, name)[kept] for name in ("frame", "s", "points", "sigma")}
        return replace(self, **parts, error_model=UNIT_ERRORS)

    def off(self, values: np.ndarray) -> tuple[float, float]:
        """Mean square distance of one candidate (P,) from the measured points, and from those nearest the tip [m2]."""
        _, motion = next(self.simulate(values[None]))
        squares = np.sum((self.at_measured(motion.points)[0] - self.points) ** 2, axis=-1)
        return float(squares.mean()), float(squares[self.s == self.s.max()].mean())


def case(model: Model, observation: Observation) -> Case:
    """Make one observation ready; raises DataError where it cannot be used."""
    points = observation.read
    points = points[np.isfinite(points[["t", "s", "x", "y"]]).all(axis=1)].sort_values(["t", "s"], kind="stable")
    if points.empty:
        raise DataError(f"trial {observation.trial}: no valid point of the string. Look at its readings' reasons.")
    times, frame = np.unique(points["t"].to_numpy(), return_inverse=True)
    sigma = points["sigma"].to_numpy() if "sigma" in points else np.ones(len(points))
    position = points[["x", "y"]].to_numpy()
    s, motion = points["s"].to_numpy(), motion_of(observation).lasting(times[-1])
    ready = Case(observation.trial, model, motion, times, frame, s, position, sigma)
    hand, known = motion.actual(model.arm, ()), "sigma" in points
    if observation.moving:
        begun = _begun(ready, hand, known)
        return replace(ready, initial=begun, turn=_turn(hand, begun))
    try:
        return replace(ready, turn=_turn(hand, _begun(ready, hand, known))) if _points_up(hand) else ready
    except DataError:  # the first frames do not show it
        return ready


def _begun(ready: Case, hand: HandMotion, known: bool) -> State:
    """The state in which a trial begins. known: the points' sigma is."""
    length = ready.model.string.length
    first = (ready.times, ready.frame, ready.s, ready.points)
    try:
        seen = kinematics(*first, float(np.median(ready.sigma)) if known else None, length)
    except DataError as error:
        raise DataError(f"trial {ready.name}: {error}") from error
    return initial_state(hand, length, ready.times, seen)


def _turn(hand: HandMotion, begun: State) -> float:
    """How far the string turns from a hand that points up to its end [rad]; 0 where the hand points down, from where
    there is one way."""
    return float(begun.angle[-1] - hand.pose[0, 0, 2]) if _points_up(hand) else 0.0


def _points_up(hand: HandMotion) -> bool:
    return bool(np.sin(hand.pose[0, 0, 2]) > 0)


def motion_of(observation: Observation) -> JointMotion | HandMotion:
    """The motion as the arm reports it: joint angles or poses of the grasp."""
    if observation.arm is not None:
        return joint_motion(observation.arm["t"].to_numpy(), observation.arm[list(JOINTS)].to_numpy())
    if observation.grasp is None:
        raise DataError(
            f"trial {observation.trial}: neither joint angles nor grasp poses. Add arm.parquet or grasp.parquet."
        )
    return hand_motion_from_grasp(observation.grasp["t"].to_numpy(), observation.grasp[["x", "y", "theta"]].to_numpy())
