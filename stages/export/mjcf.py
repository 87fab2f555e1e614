"""Export of a string to MuJoCo.

Links are connected by hinges with springs and dampers, and carry a mass point at their
end. Links do not stretch; everything else of the string is exported. MuJoCo's ellipsoid
model of a sphere gives the drag of each point: its viscous force 6 pi eta r v is the
linear drag, and its blunt drag rho C pi r^2 |v| v is the quadratic one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.model.effect import StringEffect, is_position_dependent
from stringcast.stages.model.engine.stability import vector_slot_sum
from stringcast.stages.model.model import Model
from stringcast.stages.model.statics.chain import grasp_rest_angle
from stringcast.stages.model.statics.equilibrium import hanging_shape
from stringcast.stages.model.string import PAPER_EFFECTS

EXPORTED_ARGUMENTS = {
    "acceleration",
    "flow",
    "rest_curvature",
    "density",
    "tip_mass",
    "tip_length",
    "hidden_length",
    "grasp_offset",
}
# of the air: spheres of the drag's size then carry hardly any air along
VISCOSITY_PA_S, DENSITY_KG_M3 = 0.1, 1.0
GYRATION_RADIUS = 1e-3  # of a mass point, in segments
# pose of a grasp from which the string hangs straight
HANGING_POSE = np.array([[0.0, 0.0, -np.pi / 2]])
# times the string's mass: the string does not move such a hand
CARRIAGE_MASS_RATIO = 1e6

DOCUMENT_TEMPLATE = """\
<mujoco model="string">
  <!-- Written by stringcast: {segments} links, {length:g} m, {mass:g} kg. Planar, x \
to the right, y up.
       Links do not stretch; hung up at rest, the string is {stretch:.2f} mm \
longer.{omitted}
       The hand is a carriage; to hang the string in a gripper of yours, take body \
link_1 with all that is in it. -->
  <compiler angle="radian"/>
  <option timestep="{step:g}" integrator="implicitfast" gravity="{gx:.9g} {gy:.9g} 0" \
wind="{wx:.9g} {wy:.9g} 0" \
density="{density:g}" viscosity="{viscosity:g}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="hand" gravcomp="1">
      <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
      <joint name="hand_x" type="slide" axis="1 0 0" armature="{heavy:.9g}"/>
      <joint name="hand_y" type="slide" axis="0 1 0" armature="{heavy:.9g}"/>
      <joint name="hand_theta" type="hinge" axis="0 0 1" armature="{heavy:.9g}"/>
{chain}
    </body>
  </worldbody>
  <actuator>
    <motor joint="hand_x"/> <motor joint="hand_y"/> <motor joint="hand_theta"/>
  </actuator>
  <sensor>
    <framepos name="tip" objtype="site" objname="tip"/>
  </sensor>
</mujoco>
"""
LINK_TEMPLATE = """\
{pad}<body name="link_{number}" pos="{start:.9g} {across:.9g} 0">
{pad}  <joint name="hinge_{number}" type="hinge" axis="0 0 1" \
stiffness="{stiffness:.9g}" damping="{damping:.9g}" \
springref="{rest:.9g}"/>
{pad}  <inertial pos="{length:.9g} 0 0" mass="{mass:.9g}" diaginertia="{inertia:.9g} \
{inertia:.9g} {inertia:.9g}"/>
{pad}  <geom type="sphere" pos="{length:.9g} 0 0" size="{radius:.9g}" mass="0" \
contype="0" conaffinity="0" \
fluidshape="ellipsoid" fluidcoef="{blunt:.9g} 0 0 0 0"/>
"""


def build_mjcf(model: Model, values: np.ndarray, mass: float, step: float) -> str:
    """Return the string of a model as an MJCF document.

    Effects on hand, clocks and camera are no part of a string and are left out.

    Parameters
    ----------
    model
        The model.
    values
        Its parameters (P,).
    mass
        Mass of the string [kg], which motion alone does not determine.
    step
        Time step [s].

    Returns
    -------
    str
        The document.

    Raises
    ------
    DataError
        If MuJoCo has no law for an effect on the string.
    """
    string = model.string
    for effect in string.effects:
        if effect in PAPER_EFFECTS:
            continue
        laws = effect.laws()
        if is_position_dependent(effect) or not set(laws) <= EXPORTED_ARGUMENTS:
            raise DataError(
                f"effect '{effect.name}': MuJoCo has no such law ({', '.join(laws)}). "
                "Estimate the string again without it, and export that."
            )
    material = string.material(values[None, : len(string.parameters)])
    origin = {name: np.zeros((1, 1)) for name in ("x", "y", "t")}
    gravity = vector_slot_sum(string, material, "acceleration", origin)[0, 0]
    wind = vector_slot_sum(string, material, "flow", origin)[0, 0]
    hanging_lengths = hanging_shape(string, material, HANGING_POSE)[1][0]
    stretch = (hanging_lengths - string.free_segment_lengths(material)).sum()
    others = [e.name for e in model.effects if not issubclass(e, StringEffect)]
    omitted = f" Left out, for no part of the string: {', '.join(others)}."

    # each body lies in that before it
    links = _link_rows(model, material, mass / string.length)
    start, end = "", ""
    for number, link in enumerate(links):
        pad = "  " * (3 + number)
        start += LINK_TEMPLATE.format(pad=pad, **link)
        end = f"{pad}</body>\n{end}"
    tip = f'{pad}  <site name="tip" pos="{links[-1]["length"]:.9g} 0 0"/>\n'
    return DOCUMENT_TEMPLATE.format(
        segments=string.points - 1,
        length=string.length,
        mass=mass,
        step=step,
        gx=gravity[0],
        gy=gravity[1],
        wx=wind[0],
        wy=wind[1],
        density=DENSITY_KG_M3,
        viscosity=VISCOSITY_PA_S,
        heavy=CARRIAGE_MASS_RATIO * mass,
        stretch=1e3 * float(stretch),
        omitted=omitted if others else "",
        chain=start + tip + end.rstrip("\n"),
    )


def _link_rows(
    model: Model, material: np.ndarray, mass_per_length: float
) -> list[dict[str, Any]]:
    """Return the properties of each link from the grasp to the tip.

    Parameters of the model are per mass; `mass_per_length` [kg/m] converts them.
    """
    string = model.string
    parameters = dict(zip(string.row_names, map(float, material[0]), strict=False))
    length = float(string.free_segment_lengths(material)[0])
    masses, cells = (
        rows[0, 1:] * mass_per_length for rows in string.point_masses(material)
    )
    hinges = string.free_arc_lengths(material)[:, 1:-1]
    total_length = string.length * string.free_length_ratio(material)[:, None]
    known = {"s": hinges, "length": total_length}
    curvatures = string.law_values("rest_curvature", material, known)
    curvature = sum(curvatures, np.zeros_like(hinges))[0]

    # a sphere's drag: Stokes' law gives its radius from the linear part, and both parts
    # give the coefficient of blunt drag
    radius = cells * parameters["linear_drag"] / (6 * np.pi * VISCOSITY_PA_S)
    blunt = cells * parameters["quadratic_drag"] / (DENSITY_KG_M3 * np.pi * radius**2)
    offset = np.zeros(2)
    for law_offset in string.law_values("grasp_offset", material, {}):
        offset = offset + np.ravel(law_offset)
    links = []
    for number in range(len(masses)):
        if number == 0:  # the clamp in the hand
            start, across = map(float, offset)
            stiffness = parameters["grasp_stiffness"]
            damping = parameters["grasp_damping"]
            rest = float(grasp_rest_angle(string, material)[0, 0])
        else:
            start, across = length, 0.0
            stiffness = parameters["bending_stiffness"] / length
            damping = parameters["bending_damping"] / length
            rest = curvature[number - 1] * length
        link = {
            "number": number + 1,
            "start": start,
            "across": across,
            "length": length,
            "mass": masses[number],
            "stiffness": stiffness * mass_per_length,
            "damping": damping * mass_per_length,
            "rest": rest,
            "radius": radius[number],
            "blunt": blunt[number],
            "inertia": masses[number] * (GYRATION_RADIUS * length) ** 2,
        }
        links.append(link)
    return links
