"""Joints that lag behind their command."""

import numpy as np
from scipy.interpolate import CubicSpline

from stringcast.stages.model.effect import (
    HandEffect,
    Parameter,
    Quantity,
    Values,
    is_odd,
    shifts_with,
)


class ArmLag(HandEffect):
    """A first-order lag of each joint behind its reported angle, tau y' = u - y.

    If only the grasp is known, its pose lags. The solution is exact for the cubic
    spline through the samples. The arm rests at the beginning.
    """

    name = "arm_lag"
    parameters = (
        Parameter("time_constant", "s", "time by which joints lag", 0.0, 0.1, 0.0),
    )
    reference = "Response of a first-order system to a polynomial"
    invariants = (
        is_odd("joints", "angles"),
        shifts_with("joints", "angles"),
        is_odd("grasp", "pose"),
        shifts_with("grasp", "pose"),
    )

    @staticmethod
    def describe(values: Values) -> str:
        return (
            f"the joints lag {1e3 * values['time_constant']:.1f} ms behind their "
            f"reported angles"
        )

    @staticmethod
    def joints(
        t: np.ndarray, angles: np.ndarray, time_constant: Quantity
    ) -> np.ndarray:
        """Return y = u - e.

        In each interval the lag e is a polynomial in the spline's derivatives plus an
        exponential decay.
        """
        spline = CubicSpline(t, angles, axis=1, bc_type="natural")
        third = np.diff(spline(t, 2), axis=1) / np.diff(t)[:, None]
        tau = time_constant
        # The polynomial part of e: tau u' - tau^2 u'' + tau^3 u'''
        at_start, at_end = (
            tau * (spline(u, 1) - tau * (spline(u, 2) - tau * third))
            for u in (t[:-1], t[1:])
        )
        decay = np.exp(-np.diff(t)[:, None] / np.maximum(time_constant, 1e-12))
        lag = np.zeros(np.broadcast_shapes(angles.shape, np.shape(time_constant)))
        change = at_end - decay * at_start
        for k in range(len(t) - 1):
            lag[:, k + 1] = decay[..., k, :] * lag[:, k] + change[:, k]
        return angles - lag

    @staticmethod
    def grasp(t: np.ndarray, pose: np.ndarray, time_constant: Quantity) -> np.ndarray:
        """Return the lagged pose."""
        return ArmLag.joints(t, pose, time_constant)
