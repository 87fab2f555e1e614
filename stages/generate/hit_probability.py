"""Distance of the tip from the target, for each of many motions and samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.generate.curves import Curves
from stringcast.stages.generate.mesh_correction import MeshCorrection
from stringcast.stages.generate.repeated_misfit import RepeatedMisfit
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.model.box import Box
from stringcast.stages.model.engine.kernel_codegen import LANES
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target

# strings simulated at once; larger batches do not fit into the processor's cache
BATCH_SIZE = 128
# factor of the closeness if something is touched only at the end
CONTACT_WEIGHT = 0.5
# scaled distance at a corner of the box with the largest arrival error, plus rounding
FARTHEST_HIT = math.sqrt(3) + 1e-9


@dataclass(frozen=True)
class CastTask:
    """The task of a cast.

    Parameters
    ----------
    model : string, arm and camera
    target : box that the tip should enter, with the wanted direction and speed
    obstacles : boxes that the arm may not touch at all, and the string not before it
        hits
    misfit : misfit of the last cast, which similar motions repeat; None if unknown
    mesh : correction for the error of the mesh; None if parameters compensate for it
    """

    model: Model
    target: Target
    obstacles: Sequence[Box]
    misfit: RepeatedMisfit | None = None
    mesh: MeshCorrection | None = None


@dataclass(frozen=True)
class CastOutcome:
    """Outcome of M motions under K samples, (M, K) each.

    Parameters
    ----------
    distance : least scaled distance of the tip from the target before the first
        contact: from its centre in half widths and half heights, and from the wanted
        arrival in tolerances; infinite where the simulation diverges
    free_share : share of the motion before arm or string touches an obstacle; 1 without
        contact
    hit : whether the tip enters the target before the first contact, as in
        `stages.hit_test`, and the arm touches nothing at all
    """

    distance: np.ndarray
    free_share: np.ndarray
    hit: np.ndarray

    @property
    def closeness(self) -> np.ndarray:
        """Smooth substitute for each motion's share of samples that hit, (M,).

        1 / (1 + d^2) is 1 at the centre and 1/2 on the inscribed ellipse, and still
        decreases far away. A contact lowers it, an early contact more than a late one.
        """
        contact_weight = CONTACT_WEIGHT * self.free_share
        weight = np.where(self.free_share == 1, 1, contact_weight)
        return np.mean(weight / (1 + self.distance**2), axis=1)


@dataclass(frozen=True)
class SimulatedMotions:
    """M motions, each simulated under the same K samples.

    Parameters
    ----------
    curves : the motions
    samples : the samples
    angles : (M K, T, J) joint angles at the ticks [rad]
    simulated : (M K, T, n, 2) simulated points of the string at the ticks [m]
    error_share : (n,) error of each point as a share of the tip's
    tip_error : (M K, T or 1, 2) error of the simulated tip [m]
    """

    curves: Curves
    samples: UncertaintySamples
    angles: np.ndarray
    simulated: np.ndarray
    error_share: np.ndarray
    tip_error: np.ndarray

    @property
    def tip(self) -> np.ndarray:
        """Positions of the tip at the ticks, with its error, (M K, T, 2) [m]."""
        error = self.error_share[-1] * self.tip_error
        return self.simulated[:, :, -1] + error

    @property
    def points(self) -> np.ndarray:
        """Points of the string at the ticks, with their error, (M K, T, n, 2) [m]."""
        errors = self.error_share[:, None] * self.tip_error[:, :, None]
        return self.simulated + errors

    def judge(self, task: CastTask) -> CastOutcome:
        """Compute how near the tips come to a task's target before any contact."""
        shape = (len(self.curves.duration), len(self.samples))
        end = (self.curves.duration[:, None] - self.samples.lag).ravel()
        times = np.arange(self.simulated.shape[1]) * task.model.arm.tick
        moving = times <= end[:, None] + 1e-9
        path = midpoint_tip_path(self.tip)
        finite = np.isfinite(path).all(axis=(1, 2))

        arm_touches, string_touches = _contact_ticks(task, self)
        arm_touches &= moving
        string_touches &= moving
        free = ~np.logical_or.accumulate(arm_touches | string_touches, axis=1) & moving
        free_share = free.sum(axis=1) / moving.sum(axis=1)
        counts = free[:, 1:].repeat(2, axis=1)  # segments of the path, two to a tick

        target = task.target
        distance = distances_of_segments((path - target.centre) / target.half_size)
        arrival_error = np.zeros_like(distance)
        if target.restricts_arrival:
            half_tick = task.model.arm.tick / 2
            velocity = np.diff(path, axis=1) / half_tick
            arrival_error = target.arrival_error(velocity)
            distance = np.hypot(distance, arrival_error)
        least = np.where(counts, distance, np.inf).min(axis=1)

        hit = finite & ~arm_touches.any(axis=1) & (least <= FARTHEST_HIT)
        entered = target.is_crossed_along(path[hit]) & (arrival_error[hit] <= 1)
        hit[hit] = (entered & counts[hit]).any(axis=1)
        return CastOutcome(
            np.where(finite, least, np.inf).reshape(shape),
            free_share.reshape(shape),
            hit.reshape(shape),
        )


def predict_outcome(
    task: CastTask, curves: Curves, samples: UncertaintySamples
) -> CastOutcome:
    """Simulate every motion under every sample, and compare the tip with the target.

    Motions of similar duration are simulated together, because a batch takes as long as
    its longest motion. Their mesh errors are computed for more motions at once than fit
    into a batch with all samples.

    Parameters
    ----------
    task : CastTask
        Model, target and obstacles.
    curves : Curves
        M motions.
    samples : UncertaintySamples
        K samples of the uncertain quantities.

    Returns
    -------
    CastOutcome
        Distance and hit of each motion under each sample.
    """
    motions = len(curves.duration)
    shape = (motions, len(samples))
    outcome = CastOutcome(np.empty(shape), np.empty(shape), np.empty(shape, bool))
    order = np.argsort(curves.duration, kind="stable")
    groups = 1 if task.mesh is None else math.ceil(motions / LANES)
    for group in np.array_split(order, groups):
        mesh_errors = find_mesh_errors(task, curves.select(group))
        batches = min(math.ceil(len(group) * len(samples) / BATCH_SIZE), len(group))
        for places in np.array_split(np.arange(len(group)), batches):
            batch = group[places]
            errors = None if mesh_errors is None else mesh_errors[:, places]
            motion = simulate_motions(task, curves.select(batch), samples, errors)
            part = motion.judge(task)
            outcome.distance[batch] = part.distance
            outcome.free_share[batch] = part.free_share
            outcome.hit[batch] = part.hit
    return outcome


def find_mesh_errors(task: CastTask, curves: Curves) -> np.ndarray | None:
    """Compute the mesh error of the tip on M motions, and its uncertainty [m].

    Returns both at T ticks, (2, M, T, 2); None if the task needs no correction. A block
    of lanes takes as long with one motion as with LANES motions.
    """
    if task.mesh is None:
        return None
    return np.stack(task.mesh.tip_errors(task.model, curves))


def simulate_motions(
    task: CastTask,
    curves: Curves,
    samples: UncertaintySamples,
    mesh_errors: np.ndarray | None = None,
) -> SimulatedMotions:
    """Simulate each motion under all samples.

    The simulation's error grows linearly along the string to its value at the tip.

    Parameters
    ----------
    task : CastTask
        Model, and misfit of the last cast.
    curves : Curves
        M motions.
    samples : UncertaintySamples
        K samples of the uncertain quantities.
    mesh_errors : (2, M, T or more, 2) array, optional
        Result of `find_mesh_errors`, if it is known.
    """
    model = task.model
    motion = sample_joint_motions(model, curves, samples)
    times = np.arange(motion.angles.shape[1]) * model.arm.tick
    repeated = samples.select(np.tile(np.arange(len(samples)), len(curves.duration)))
    simulated = model.simulate_string(motion, repeated.values, times).points
    share = model.string.arc_lengths() / model.string.length
    sigma: float | np.ndarray = samples.tip_sigma
    mesh_error = np.zeros(1)
    if mesh_errors is None:
        mesh_errors = find_mesh_errors(task, curves)
    if mesh_errors is not None:
        mesh_error, uncertainty = mesh_errors[:, :, : len(times)]
        mesh_error = mesh_error.repeat(len(samples), axis=0)  # (M K, T, 2)
        sigma = np.hypot(sigma, uncertainty)
    errors = mesh_error + tip_errors(task.misfit, curves, sigma, samples.tip_normal)
    return SimulatedMotions(curves, samples, motion.angles, simulated, share, errors)


def tip_errors(
    misfit: RepeatedMisfit | None,
    curves: Curves,
    sigma: float | np.ndarray,
    normal: np.ndarray,
) -> np.ndarray:
    """Return errors of the simulated tip on M motions under K samples, (M K, T, 2) [m].

    A motion repeats the misfit of the last cast in proportion to their correlation. The
    rest of the error is random. Its sigma is the larger of `sigma` and the largest
    misfit so far. T is the number of ticks, or 1 for constant errors.

    Parameters
    ----------
    misfit : RepeatedMisfit or None
        Misfit of the last cast.
    curves : Curves
        M motions.
    sigma : float or (M, T, 2) array
        Least error of a coordinate [m].
    normal : (K, 2) array
        The random error of each sample in units of its sigma.
    """
    motions = len(curves.duration)
    sigma = np.atleast_3d(sigma)  # (M, T, 2), or (1, 1, 1)
    normal = normal[:, None]  # (K, 1, 2)
    if misfit is None:
        errors = sigma[:, None] * normal  # (M or 1, K, T or 1, 2)
        errors = np.broadcast_to(errors, (motions, *errors.shape[1:]))
        return errors.reshape(-1, *errors.shape[2:])
    correlation = misfit.correlation(curves, float(curves.duration.max()))
    repeated = correlation[..., None] * misfit.tip_at_ticks(correlation.shape[1])
    largest = misfit.sigma_at_ticks(correlation.shape[1])
    unexplained = np.sqrt(1 - correlation**2)[..., None]
    spread = np.maximum(largest[:, None], sigma) * unexplained  # (M, T, 2)
    errors = repeated[:, None] + spread[:, None] * normal  # (M, K, T, 2)
    return errors.reshape(-1, *errors.shape[2:])


def sample_joint_motions(
    model: Model, curves: Curves, samples: UncertaintySamples
) -> JointMotion:
    """Return the joint motions of M motions under K samples, each with its gain."""
    tick = model.arm.tick
    angles, speeds = curves.sample(tick, float(curves.duration.max()))
    angles = angles.repeat(len(samples), axis=0)
    speeds = speeds.repeat(len(samples), axis=0)
    gain = 1 + np.tile(samples.amplitude, (len(curves.duration), 1))[:, None]
    start = angles[:, :1]
    turned = start + gain * (angles - start)
    return JointMotion(0.0, tick, turned, gain * speeds)


def midpoint_tip_path(tip: np.ndarray) -> np.ndarray:
    """Insert a point between every two points of the tip's path by a cubic.

    The segments are then straight to 1 mm even at 1000 m/s^2.

    Parameters
    ----------
    tip : (C, T, 2) array
        Positions of the tip at the ticks [m].

    Returns
    -------
    (C, 2 T - 1, 2) array
        Positions at the ticks and between them [m].
    """
    before_start = 2 * tip[:, :1] - tip[:, 1:2]
    after_end = 2 * tip[:, -1:] - tip[:, -2:-1]
    padded = np.concatenate([before_start, tip, after_end], axis=1)
    nearer_two = tip[:, :-1] + tip[:, 1:]
    middles = (9 * nearer_two - padded[:, :-3] - padded[:, 3:]) / 16
    path = np.repeat(tip, 2, axis=1)[:, :-1]
    path[:, 1::2] = middles
    return path


def distances_of_segments(path: np.ndarray) -> np.ndarray:
    """Compute how near each segment of paths (C, K, 2) comes to zero, (C, K - 1)."""
    # coordinate by coordinate: NumPy is slow along an axis of two
    x, y = path[..., 0], path[..., 1]
    start_x, start_y = x[:, :-1], y[:, :-1]
    segment_x, segment_y = np.diff(x, axis=1), np.diff(y, axis=1)
    square = segment_x**2 + segment_y**2
    product = start_x * segment_x + start_y * segment_y
    share = np.clip(-product / np.maximum(square, 1e-300), 0, 1)  # of each segment
    nearest_x = start_x + share * segment_x
    nearest_y = start_y + share * segment_y
    return np.hypot(nearest_x, nearest_y)


def _contact_ticks(
    task: CastTask, motions: SimulatedMotions
) -> tuple[np.ndarray, np.ndarray]:
    """Return whether arm and string touch an obstacle at each tick, (C, T) each.

    The string's contacts include those of the tip's path since the tick before.
    """
    arm, string = np.zeros((2, *motions.simulated.shape[:2]), dtype=bool)
    if not task.obstacles:
        return arm, string
    joints = task.model.arm.joint_positions(motions.angles)
    points = motions.points
    tip = points[:, :, -1]
    lowest, highest = points.min(axis=2), points.max(axis=2)
    for box in task.obstacles:
        arm |= box.is_crossed_along(joints).any(axis=2)
        # only strings whose bounding box overlaps the obstacle are examined closely
        is_beyond = lowest > box.centre + box.half_size
        is_before = highest < box.centre - box.half_size
        is_near = ~(is_beyond | is_before).any(axis=2)
        string[is_near] |= box.is_crossed_along(points[is_near]).any(axis=1)
        string[:, 1:] |= box.is_crossed_along(tip)
    return arm, string
