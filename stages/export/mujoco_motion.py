"""Simulate an exported string in MuJoCo, to compare it with measured points."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.export.mjcf import CARRIAGE_JOINTS
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.interpolation import interpolate_rows

mujoco = LazyModule("mujoco")


def simulate_chain(document: str, hand: HandMotion, times: np.ndarray) -> np.ndarray:
    """Simulate an exported string along a motion of the hand.

    The string starts at rest, in the pose of the document's keyframe. Before each step
    the hand is set to its prescribed pose.

    Parameters
    ----------
    document : str
        Document of `build_mjcf` for the first pose of the hand.
    hand : HandMotion
        Actual motion of the hand; a single one.
    times : ndarray of shape (F,)
        Ascending times [s].

    Returns
    -------
    ndarray of shape (F, n, 2)
        Points of the string from the grasp to the tip [m].
    """
    model = mujoco.MjModel.from_xml_string(document)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    step = model.opt.timestep
    begin = min(hand.start, float(times[0])) - step
    count = int(np.ceil((times[-1] - begin) / step)) + 2
    moments = begin + step * np.arange(count)

    # MuJoCo's velocities lie half a step before its poses; these bring the hand to its
    # next pose
    spline = CubicHermiteSpline(hand.times, hand.pose[0], hand.rate[0])
    around = begin + step * np.arange(-1, count + 1)  # one more step at either end
    poses = spline(np.clip(around, hand.start, hand.end))
    rates = np.diff(poses, axis=0) / step
    accelerations = np.diff(rates, axis=0) / step
    carriage = slice(CARRIAGE_JOINTS)

    shapes = np.empty((count, model.ngeom + 1, 2))
    for number in range(count):
        data.qpos[carriage] = poses[number + 1]
        data.qvel[carriage] = rates[number]
        data.ctrl[:] = model.dof_armature[carriage] * accelerations[number]
        mujoco.mj_kinematics(model, data)
        shapes[number, 0] = data.xanchor[CARRIAGE_JOINTS, :2]
        shapes[number, 1:] = data.geom_xpos[:, :2]
        mujoco.mj_step(model, data)
    coordinates = interpolate_rows(times, moments, shapes.reshape(count, -1))
    return coordinates.reshape(len(times), -1, 2)


def tip_distances(trial: PreparedTrial, points: np.ndarray) -> np.ndarray:
    """Return distances between simulated and measured outermost points [m].

    Parameters
    ----------
    trial : PreparedTrial
        Measured trial.
    points : ndarray of shape (F, n, 2)
        Simulated points at the trial's frames, as the camera reports them.

    Returns
    -------
    ndarray of shape (F,)
        NaN in frames that do not show the tip.
    """
    arc_lengths = trial.model.string.arc_lengths()
    is_outermost = trial.s >= trial.s.max() - arc_lengths[1] / 2
    distances = np.full(len(trial.times), np.nan)
    for row in np.flatnonzero(is_outermost):
        frame = trial.frame[row]
        simulated = interpolate_rows(trial.s[row], arc_lengths, points[frame])
        distances[frame] = np.linalg.norm(trial.points[row] - simulated)
    return distances
