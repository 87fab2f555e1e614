"""The string that a laboratory hangs in the hand, as a continuum with every property it
may have, absent at zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Rod(NamedTuple):
    """A planar extensible rod. All but `length` is over its nominal mass per length; SI
    units.

    It holds N = axial e + axial_damping e' and M = bending k + bending_damping k', with
    the stretch e and the turn k of its tangent per unstretched length; no shear, no
    rotary inertia. A spring and a damper hold its first tangent to the grasp's
    direction. The air takes (linear_drag + quadratic_drag |u|) u of force per
    unstretched length.
    """

    length: float
    axial: float
    axial_damping: float
    bending: float
    bending_damping: float
    linear_drag: float
    quadratic_drag: float
    grasp_stiffness: float
    grasp_damping: float
    gravity_x: float = 0.0
    gravity_y: float = -9.81
    # mass: of a knot at the tip and of a bead on the way, over the string's; rise of
    # the density over its mean
    tip_mass: float = 0.0
    bead_mass: float = 0.0
    bead_place: float = 0.5  # over the length
    taper: float = 0.0
    # bending: natural curvature; its own square law; Bouc and Wen's friction; Zener's
    # branch; uneven stiffness
    set_curvature: float = 0.0
    hardening: float = 0.0  # [m2]
    rub: float = 0.0  # [m3/s2]
    rub_curvature: float = 0.1  # [1/m]
    relaxing: float = 0.0  # [m4/s2]
    relaxation: float = 0.1  # [s]
    stiffness_taper: float = 0.0
    soft_loss: float = 0.0
    soft_place: float = 0.5
    # the grasp lets go slowly, from a time on
    grasp_loss: float = 0.0  # [1/s]
    grasp_loss_from: float = 0.0
    # air: wind, a gust, a flutter, an eddy; drag across the string; a flag at the tip;
    # less drag above a speed
    wind_x: float = 0.0
    wind_y: float = 0.0
    gust_x: float = 0.0
    gust_y: float = 0.0
    gust_when: float = 0.0
    gust_lasts: float = 0.1
    flutter_x: float = 0.0
    flutter_y: float = 0.0
    flutter_frequency: float = 5.0  # [Hz]
    eddy: float = 0.0  # largest speed [m/s]
    eddy_x: float = 0.0
    eddy_y: float = 0.0
    eddy_core: float = 0.1
    across: float = 0.0
    flag: float = 0.0  # [1]
    crisis: float = 0.0
    crisis_speed: float = 3.0
    # what stands in the way: a plane (normal, height), a peg, a thread at the tip
    plane: float = 0.0  # [1/s2]
    plane_x: float = 0.0
    plane_y: float = 1.0
    plane_height: float = 0.0
    plane_friction: float = 0.0
    plane_loss: float = 0.0  # [1/s]
    peg: float = 0.0  # [1/s2]
    peg_x: float = 0.0
    peg_y: float = 0.0
    peg_radius: float = 0.02
    thread: float = 0.0  # [1/s2]
    thread_x: float = 0.0
    thread_y: float = 0.0
    thread_slack: float = 0.0
    # what acts at a place or at a time
    pull: float = 0.0  # [m/s2]
    pull_x: float = 0.0
    pull_y: float = 0.0
    pull_reach: float = 0.1
    blow_x: float = 0.0  # [m/s2]
    blow_y: float = 0.0
    blow_when: float = 0.0
    blow_place: float = 0.7
    hold: float = 0.0  # [1/s]
    hold_from: float = 0.0
    hold_until: float = 0.0
    hold_place: float = 0.7

    @property
    def record(self) -> np.void:
        """The rod as a NumPy record, which compiled code takes."""
        record: np.void = np.array(
            [tuple(self)], dtype=[(name, float) for name in self._fields]
        )[0]
        return record

    @staticmethod
    def of_points(length: float, **per_point: float) -> Rod:
        """A rod by the paper's parameters, per unit mass of a mass point at n = 10."""
        segment = length / 9
        named = {
            FIELDS[name]: value * segment ** POWERS[name]
            for name, value in per_point.items()
        }
        return Rod(length, **named)

    def in_points(self) -> dict[str, float]:
        """The inverse of `of_points`."""
        segment = self.length / 9
        return {
            name: float(getattr(self, field) / segment ** POWERS[name])
            for name, field in FIELDS.items()
        }


# The paper's names, and by which power of a segment's length they are multiplied to be
# the material's.
FIELDS = {
    "axial_stiffness": "axial",
    "axial_damping": "axial_damping",
    "bending_stiffness": "bending",
    "bending_damping": "bending_damping",
    "linear_drag": "linear_drag",
    "quadratic_drag": "quadratic_drag",
    "grasp_stiffness": "grasp_stiffness",
    "grasp_damping": "grasp_damping",
}
POWERS = dict(zip(FIELDS, (2, 2, 2, 2, 0, 0, 1, 1), strict=True))
