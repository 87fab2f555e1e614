"""The string as MuJoCo has it: links that do not stretch on hinges with springs and
dampers, mass points at their ends.

All that bends, weighs or is blown about is carried over as it is; a segment's stretch
is not. Air resists each point by MuJoCo's ellipsoid model of a ball: its viscous force
6 pi eta r v is the linear drag, its blunt drag rho C pi r^2 |v| v the squared one.
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

# slots that MuJoCo has, too
EXPORTED_ARGUMENTS = {
    "acceleration",
    "flow",
    "rest_curvature",
    "density",
    "tip_mass",
    "tip_length",
}
EXPORTED_ARGUMENTS |= {"hidden_length", "grasp_offset"}
# of the air [Pa s], [kg/m3]: such that a ball moves no air to speak of along with it
VISCOSITY, DENSITY = 0.1, 1.0
MIN_MASS_SHARE = 1e-3  # radius of gyration of a mass point, in segments
# pose of a grasp from which the string hangs straight
HANGING_POSE = np.array([[0.0, 0.0, -np.pi / 2]])
# times the string's mass (times m^2 for turns): a hand that the string does not move
CARRIAGE_MASS_KG = 1e6

DOCUMENT_TEMPLATE = """\
<mujoco model="string">
  <!-- Written by stringcast: {segments} links, {length:g} m, {mass:g} kg. Planar, x to the right, y up.
       Links do not stretch; hung up at rest, the string is {longer:.2f} mm longer.{stated}
       The hand is a carriage; to hang the string in a gripper of yours, take body link_1 with all that is in it. -->
  <compiler angle="radian"/>
  <option timestep="{step:g}" integrator="implicitfast" gravity="{gx:.9g} {gy:.9g} 0" wind="{wx:.9g} {wy:.9g} 0" \
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
{pad}<body name="link_{number}" pos="{start:.9g} {beside:.9g} 0">
{pad}  <joint name="hinge_{number}" type="hinge" axis="0 0 1" stiffness="{stiffness:.9g}" damping="{damping:.9g}" \
springref="{rest:.9g}"/>
{pad}  <inertial pos="{length:.9g} 0 0" mass="{mass:.9g}" diaginertia="{inertia:.9g} {inertia:.9g} {inertia:.9g}"/>
{pad}  <geom type="sphere" pos="{length:.9g} 0 0" size="{radius:.9g}" mass="0" contype="0" conaffinity="0" \
fluidshape="ellipsoid" fluidcoef="{blunt:.9g} 0 0 0 0"/>
"""


def build_mjcf(model: Model, values: np.ndarray, mass: float, step: float) -> str:
    """The string of a model as an MJCF document.

    values: (P,) of its parameters. mass: of the string [kg], which motion alone does
    not tell. step: [s]. Effects on hand, clocks and camera are no part of a string, and
    are left out. Raises DataError for one on the string that MuJoCo has no law for.
    """
    string = model.string
    for effect in string.effects:
        if effect not in PAPER_EFFECTS and (
            is_position_dependent(effect)
            or not set(effect.laws()) <= EXPORTED_ARGUMENTS
        ):
            raise DataError(
                f"effect '{effect.name}': MuJoCo has no such law ({', '.join(effect.laws())}). Estimate the string "
                "again without it, and export that."
            )
    material = string.material(values[None, : len(string.parameters)])
    # mass per length, by which everything of ours is divided [kg/m]
    over = mass / string.length
    nothing = {"x": np.zeros((1, 1)), "y": np.zeros((1, 1)), "t": np.zeros((1, 1))}
    gravity, wind = (
        vector_slot_sum(string, material, slot, nothing)[0, 0]
        for slot in ("acceleration", "flow")
    )
    beside = [
        effect.name for effect in model.effects if not issubclass(effect, StringEffect)
    ]

    # bodies one inside the other
    links = _link_rows(model, material, over)
    pads = ["  " * (3 + i) for i in range(len(links))]
    opened = "".join(
        LINK_TEMPLATE.format(pad=pad, **link)
        for pad, link in zip(pads, links, strict=True)
    )
    tip = f'{pads[-1]}  <site name="tip" pos="{links[-1]["length"]:.9g} 0 0"/>\n'
    closed = "\n".join(f"{pad}</body>" for pad in reversed(pads))
    return DOCUMENT_TEMPLATE.format(
        **{
            "segments": string.points - 1,
            "length": string.length,
            "mass": mass,
            "step": step,
        },
        **{"gx": gravity[0], "gy": gravity[1], "wx": wind[0], "wy": wind[1]},
        **{
            "density": DENSITY,
            "viscosity": VISCOSITY,
            "heavy": CARRIAGE_MASS_KG * mass,
        },
        longer=1e3
        * float(
            (
                hanging_shape(string, material, HANGING_POSE)[1][0]
                - string.free_segment_lengths(material)
            ).sum()
        ),
        stated=f" Left out, for no part of the string: {', '.join(beside)}."
        if beside
        else "",
        chain=opened + tip + closed,
    )


def _link_rows(model: Model, material: np.ndarray, over: float) -> list[dict[str, Any]]:
    """The properties of each link, from the grasp to the tip. over: mass per length
    [kg/m].
    """
    string = model.string
    named = {
        name: float(material[0, place]) for place, name in enumerate(string.row_names)
    }
    length = float(string.free_segment_lengths(material)[0])
    masses, cells = (rows[0, 1:] * over for rows in string.point_masses(material))
    places = string.free_arc_lengths(material)[:, 1:-1]
    given = {
        "s": places,
        "length": string.length * string.free_length_ratio(material)[:, None],
    }
    rest = (
        sum(
            string.law_values("rest_curvature", material, given), np.zeros_like(places)
        )[0]
        * length
    )
    hinges = [
        (
            named["grasp_stiffness"],
            named["grasp_damping"],
            float(grasp_rest_angle(string, material)[0, 0]),
        )
    ]
    hinges += [
        (named["bending_stiffness"] / length, named["bending_damping"] / length, angle)
        for angle in rest
    ]
    # a sphere's drag: by Stokes its radius follows from the linear part, and the
    # coefficient of the rest from both
    radius = cells * named["linear_drag"] / (6 * np.pi * VISCOSITY)
    blunt = cells * named["quadratic_drag"] / (DENSITY * np.pi * radius**2)
    offsets = [
        np.ravel(offset) for offset in string.law_values("grasp_offset", material, {})
    ]
    along, across = np.sum([np.zeros(2), *offsets], axis=0)
    return [
        {
            "number": i + 1,
            "start": length if i else along,
            "beside": 0.0 if i else across,
        }
        | {"length": length, "mass": masses[i]}
        | {
            "stiffness": stiff * over,
            "damping": damped * over,
            "rest": angle,
            "radius": radius[i],
            "blunt": blunt[i],
        }
        | {"inertia": masses[i] * (MIN_MASS_SHARE * length) ** 2}
        for i, (stiff, damped, angle) in enumerate(hinges)
    ]
