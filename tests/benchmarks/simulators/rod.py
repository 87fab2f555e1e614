"""The string as a continuum, with every property that a hidden cause may change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Rod(NamedTuple):
    """A planar extensible rod in SI units, over its nominal mass per length.

    It holds the tension N = axial e + axial_damping e' and the bending moment
    M = bending k + bending_damping k', with the stretch e and the turn k of its
    tangent per unstretched length. It has no shear and no rotary inertia. A spring
    and a damper hold its first tangent to the grasp's direction. The air resists with
    (linear_drag + quadratic_drag |u|) u per unstretched length. All properties after
    `gravity_y` belong to causes and are absent at zero.
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
    # masses over the string's; rise of the density over its mean
    tip_mass: float = 0.0
    bead_mass: float = 0.0
    bead_place: float = 0.15  # [m] along the string
    taper: float = 0.0
    # bending: curvature at rest, nonlinear law, friction (Bouc and Wen), relaxation
    # (Zener), uneven stiffness
    rest_curvature: float = 0.0  # [1/m]
    hardening: float = 0.0  # [m2]
    friction: float = 0.0  # [m3/s2]
    friction_curvature: float = 0.1  # [1/m]
    relaxing_stiffness: float = 0.0  # [m4/s2]
    relaxation_time: float = 0.1  # [s]
    stiffness_taper: float = 0.0
    soft_spot: float = 0.0  # share of the stiffness that is lost
    soft_spot_place: float = 0.15  # [m] along the string
    # the grasp slowly loosens from a time on
    grasp_loss: float = 0.0  # [1/s]
    grasp_loss_from: float = 0.0  # [s]
    # air: wind, gust, oscillating wind, vortex [m/s]; drag across the string over that
    # along it, less 1; a flag at the tip; drag that drops above a speed
    wind_x: float = 0.0
    wind_y: float = 0.0
    gust_x: float = 0.0
    gust_y: float = 0.0
    gust_when: float = 0.0  # [s]
    gust_lasts: float = 0.1  # [s]
    flutter_x: float = 0.0
    flutter_y: float = 0.0
    flutter_frequency: float = 5.0  # [Hz]
    vortex: float = 0.0
    vortex_x: float = 0.0  # [m]
    vortex_y: float = 0.0
    vortex_core: float = 0.1
    cross_drag: float = 0.0
    flag: float = 0.0
    drag_drop: float = 0.0  # share of the quadratic drag
    drag_drop_speed: float = 3.0  # [m/s]
    # obstacles: a plane (normal, height), a round peg, a thread at the tip
    plane: float = 0.0  # [1/s2]
    plane_x: float = 0.0
    plane_y: float = 1.0
    plane_height: float = 0.0  # [m]
    plane_friction: float = 0.0
    plane_loss: float = 0.0  # [1/s]
    peg: float = 0.0  # [1/s2]
    peg_x: float = 0.0  # [m]
    peg_y: float = 0.0
    peg_radius: float = 0.02
    thread: float = 0.0  # [1/s2]
    thread_x: float = 0.0  # [m]
    thread_y: float = 0.0
    thread_slack: float = 0.0
    # local forces: attraction to a point, a blow, fingers that hold for a while
    attraction: float = 0.0  # [m/s2]
    attraction_x: float = 0.0  # [m]
    attraction_y: float = 0.0
    attraction_reach: float = 0.1
    blow_x: float = 0.0  # [m/s2]
    blow_y: float = 0.0
    blow_when: float = 0.0  # [s]
    blow_place: float = 0.2  # [m] along the string
    grip: float = 0.0  # [1/s]
    grip_from: float = 0.0  # [s]
    grip_until: float = 0.0
    grip_place: float = 0.2  # [m] along the string

    @property
    def record(self) -> np.void:
        """Return the rod as a NumPy record, which compiled code takes."""
        dtype = [(name, float) for name in self._fields]
        record: np.void = np.array([tuple(self)], dtype=dtype)[0]
        return record

    @staticmethod
    def from_paper_parameters(length: float, **per_point: float) -> Rod:
        """Make a rod of the paper's parameters, per mass of a point at n = 10."""
        segment = length / 9
        material = {}
        for name, value in per_point.items():
            field, power = PAPER_PARAMETERS[name]
            material[field] = value * segment**power
        return Rod(length, **material)

    def paper_parameters(self) -> dict[str, float]:
        """Return the paper's parameters, the inverse of `from_paper_parameters`."""
        segment = self.length / 9
        per_point = {}
        for name, (field, power) in PAPER_PARAMETERS.items():
            per_point[name] = float(getattr(self, field) / segment**power)
        return per_point


# For each of the paper's parameters the rod's field, and the power of a segment's
# length by which it is multiplied to become a property of the material.
PAPER_PARAMETERS = {
    "axial_stiffness": ("axial", 2),
    "axial_damping": ("axial_damping", 2),
    "bending_stiffness": ("bending", 2),
    "bending_damping": ("bending_damping", 2),
    "linear_drag": ("linear_drag", 0),
    "quadratic_drag": ("quadratic_drag", 0),
    "grasp_stiffness": ("grasp_stiffness", 1),
    "grasp_damping": ("grasp_damping", 1),
}
BASE_FIELDS = tuple(field for field, _ in PAPER_PARAMETERS.values())
