"""Export of a string to MuJoCo.

Links are connected by hinges with springs and dampers, and carry a mass point at their
end. A slide along each link lets it stretch, except for stiff strings, whose stretch is
negligible and for which MuJoCo would need tiny steps. A sphere in MuJoCo's ellipsoid
fluid model gives the drag of each point: its viscous force 6 pi eta r v is the linear
drag, and its blunt drag rho C pi r^2 |v| v is the quadratic one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stringcast.data.schema import DataError
from stringcast.stages.model.effect import StringEffect, is_position_dependent
from stringcast.stages.model.engine.stability import vector_slot_sum
from stringcast.stages.model.model import Model
from stringcast.stages.model.statics.chain import grasp_rest_angle
from stringcast.stages.model.statics.equilibrium import hanging_shape
from stringcast.stages.model.string import PAPER_EFFECTS, String

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
# a fluid in which spheres with the drag of the string have hardly any added mass
VISCOSITY_PA_S, DENSITY_KG_M3 = 0.1, 1.0
CARRIAGE_JOINTS = 3  # the first joints: x, y and angle of the hand
GYRATION_RADIUS = 1e-3  # of a mass point, in segments
# pose of a grasp from which the string hangs straight
HANGING_POSE = np.array([[0.0, 0.0, -np.pi / 2]])
# mass of the hand over that of the string; such a hand is not moved by the string
CARRIAGE_MASS_RATIO = 1e6

# largest step over the fastest spring's period divided by 2 pi; MuJoCo integrates
# springs explicitly
STEP_SHARE = 0.5
MAX_STEP_S = 5e-4
MIN_STEP_S = 2e-5  # links that need smaller steps do not stretch

DOCUMENT_TEMPLATE = """\
<mujoco model="string">
  <!-- Written by stringcast: {segments} links, {length:g} m, {mass:g} kg. Planar, x \
to the right, y up.
       {stretching} At rest its weight stretches the string by {stretch:.2f} \
mm.{omitted}
       Keyframe "rest": the string at rest in the hand.
       The hand is a carriage; to attach the string to your own gripper, copy body \
link_1 with its children. -->
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
    <motor name="push_x" joint="hand_x"/>
    <motor name="push_y" joint="hand_y"/>
    <motor name="push_theta" joint="hand_theta"/>
  </actuator>
  <sensor>
    <framepos name="tip" objtype="site" objname="tip"/>
  </sensor>
  <keyframe>
    <key name="rest" qpos="{rest}"/>
  </keyframe>
</mujoco>
"""
LINK_TEMPLATE = """\
{pad}<body name="link_{number}" pos="{start:.9g} {across:.9g} 0">
{pad}  <joint name="hinge_{number}" type="hinge" axis="0 0 1" \
stiffness="{stiffness:.9g}" damping="{damping:.9g}" \
springref="{rest:.9g}"/>
{slide}{pad}  <inertial pos="{length:.9g} 0 0" mass="{mass:.9g}" \
diaginertia="{inertia:.9g} {inertia:.9g} {inertia:.9g}"/>
{pad}  <geom type="sphere" pos="{length:.9g} 0 0" size="{radius:.9g}" mass="0" \
contype="0" conaffinity="0" \
fluidshape="ellipsoid" fluidcoef="{blunt:.9g} 0 0 0 0"/>
"""
SLIDE_TEMPLATE = """\
{pad}  <joint name="stretch_{number}" type="slide" axis="1 0 0" \
stiffness="{axial_stiffness:.9g}" damping="{axial_damping:.9g}"/>
"""

PLAYER_TEXT = """\
# Swing the hand and watch the string. Needs: pip install mujoco
import time

import mujoco.viewer
import numpy as np

model = mujoco.MjModel.from_xml_path("{file}")
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, model.key("rest").id)
push, heavy = data.actuator("push_x"), model.joint("hand_x").dofadr[0]
with mujoco.viewer.launch_passive(model, data) as viewer:
    while viewer.is_running():
        push.ctrl[0] = 2.0 * model.dof_armature[heavy] * np.cos(6.0 * data.time)
        mujoco.mj_step(model, data)
        viewer.sync()
        time.sleep(model.opt.timestep)
"""


def largest_step(model: Model, values: np.ndarray) -> float:
    """Return the largest stable time step [s] of a chain whose links stretch."""
    string = model.string
    material = string.material(values[None, : len(string.parameters)])
    parameters = dict(zip(string.row_names, material[0], strict=False))
    length = float(string.free_segment_lengths(material)[0])
    lightest = float(string.point_masses(material)[0][0, 1:].min())
    # neighbouring points that move against each other [rad/s]
    fastest = 2 * np.sqrt(parameters["axial_stiffness"] / (lightest * length))
    return float(STEP_SHARE / fastest)


def choose_step(model: Model, values: np.ndarray) -> float:
    """Choose the time step [s] of a string in MuJoCo."""
    largest = largest_step(model, values)
    if largest < MIN_STEP_S:
        return MAX_STEP_S
    return min(MAX_STEP_S, float(f"{largest:.1g}"), largest)


def build_mjcf(
    model: Model,
    values: np.ndarray,
    mass: float,
    step: float,
    pose: np.ndarray = HANGING_POSE[0],
    turn: float = 0.0,
) -> str:
    """Return the string of a model as an MJCF document.

    Effects on hand, clocks and camera are left out.

    Parameters
    ----------
    model
        The model.
    values
        Parameters of the model, (P,).
    mass
        Mass of the string [kg], which motion alone does not determine.
    step
        Time step [s].
    pose
        Pose of the hand in the keyframe, (3,): x [m], y [m], theta [rad].
    turn
        Side of the hand on which the string rests, as in `hanging_shape`.

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
    _refuse_unknown_laws(model)
    material = string.material(values[None, : len(string.parameters)])
    origin = {name: np.zeros((1, 1)) for name in ("x", "y", "t")}
    gravity = vector_slot_sum(string, material, "acceleration", origin)[0, 0]
    wind = vector_slot_sum(string, material, "flow", origin)[0, 0]
    hanging_lengths = hanging_shape(string, material, HANGING_POSE)[1][0]
    stretch = (hanging_lengths - string.free_segment_lengths(material)).sum()
    largest = largest_step(model, values)
    stretches = largest >= MIN_STEP_S
    if stretches and step > largest:
        raise DataError(
            f"--step {step:g}",
            "a string of this axial stiffness needs at most "
            f"{choose_step(model, values):g} s in MuJoCo",
            "Give that, or no --step.",
        )
    angles, lengths = hanging_shape(string, material, pose, turn)
    hinges = np.diff(angles[0], prepend=pose[2])
    elongations = lengths[0] - float(string.free_segment_lengths(material)[0])
    joints = np.stack([hinges, elongations], axis=1) if stretches else hinges
    rest = " ".join(f"{q:.9g}" for q in (*pose, *np.ravel(joints)))
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
        stretching="Links stretch." if stretches else "Links do not stretch.",
        rest=rest,
        omitted=_describe_omitted(model),
        chain=_chain_text(model, material, mass / string.length, stretches),
    )


def _describe_omitted(model: Model) -> str:
    """Name the effects that do not act on the string; empty if there are none."""
    names = [e.name for e in model.effects if not issubclass(e, StringEffect)]
    if not names:
        return ""
    return f" Left out, because not acting on the string: {', '.join(names)}."


def _refuse_unknown_laws(model: Model) -> None:
    """Raise DataError if MuJoCo has no law for an effect on the string."""
    for effect in model.string.effects:
        if effect in PAPER_EFFECTS:
            continue
        laws = effect.laws()
        if is_position_dependent(effect) or not set(laws) <= EXPORTED_ARGUMENTS:
            raise DataError(
                f"effect '{effect.name}'",
                f"MuJoCo has no such law ({', '.join(laws)})",
                "Estimate the string again without it, and export that.",
            )


def _chain_text(
    model: Model, material: np.ndarray, mass_per_length: float, stretches: bool
) -> str:
    """Return the bodies of the links, each nested in the one before."""
    start, end = "", ""
    for number, link in enumerate(_link_rows(model, material, mass_per_length)):
        pad = "  " * (3 + number)
        slide = SLIDE_TEMPLATE.format(pad=pad, **link) if stretches else ""
        start += LINK_TEMPLATE.format(pad=pad, slide=slide, **link)
        end = f"{pad}</body>\n{end}"
    tip = f'{pad}  <site name="tip" pos="{link["length"]:.9g} 0 0"/>\n'
    return start + tip + end.rstrip("\n")


def _link_rows(
    model: Model, material: np.ndarray, mass_per_length: float
) -> list[dict[str, Any]]:
    """Return the properties of each link from the grasp to the tip.

    The model's parameters are divided by mass; `mass_per_length` [kg/m] converts them.
    """
    string = model.string
    parameters = dict(zip(string.row_names, map(float, material[0]), strict=False))
    length = float(string.free_segment_lengths(material)[0])
    point_masses, cell_lengths = string.point_masses(material)
    masses = point_masses[0, 1:] * mass_per_length
    cell_masses = cell_lengths[0, 1:] * mass_per_length

    # drag of a sphere: Stokes' law gives its radius from the linear drag; radius and
    # quadratic drag give the coefficient of blunt drag
    radius = cell_masses * parameters["linear_drag"] / (6 * np.pi * VISCOSITY_PA_S)
    disc = DENSITY_KG_M3 * np.pi * radius**2  # [kg/m]
    blunt = cell_masses * parameters["quadratic_drag"] / disc
    clamp = _clamp_row(string, material, parameters)
    bends = _rest_curvatures(string, material) * length
    links = []
    for number in range(len(masses)):
        hinge = clamp
        if number > 0:
            hinge = {
                "start": length,
                "across": 0.0,
                "stiffness": parameters["bending_stiffness"] / length,
                "damping": parameters["bending_damping"] / length,
                "rest": bends[number - 1],
            }
        link = {
            "number": number + 1,
            "start": hinge["start"],
            "across": hinge["across"],
            "length": length,
            "mass": masses[number],
            "stiffness": hinge["stiffness"] * mass_per_length,
            "damping": hinge["damping"] * mass_per_length,
            "rest": hinge["rest"],
            "axial_stiffness": parameters["axial_stiffness"] / length * mass_per_length,
            "axial_damping": parameters["axial_damping"] / length * mass_per_length,
            "radius": radius[number],
            "blunt": blunt[number],
            "inertia": masses[number] * (GYRATION_RADIUS * length) ** 2,
        }
        links.append(link)
    return links


def _clamp_row(
    string: String, material: np.ndarray, parameters: Mapping[str, float]
) -> dict[str, float]:
    """Return the hinge of the first link, its clamp in the hand, per mass per length.

    start, across: position along and across the hand [m]. rest: angle [rad].
    """
    offset = np.zeros(2)
    for law_offset in string.law_values("grasp_offset", material, {}):
        offset = offset + np.ravel(law_offset)
    start, across = map(float, offset)
    return {
        "start": start,
        "across": across,
        "stiffness": parameters["grasp_stiffness"],
        "damping": parameters["grasp_damping"],
        "rest": float(grasp_rest_angle(string, material)[0, 0]),
    }


def _rest_curvatures(string: String, material: np.ndarray) -> np.ndarray:
    """Return the curvature at rest of each hinge between two links, (n - 2,) [1/m]."""
    hinges = string.free_arc_lengths(material)[:, 1:-1]
    total_length = string.length * string.free_length_ratio(material)[:, None]
    known = {"s": hinges, "length": total_length}
    curvatures = string.law_values("rest_curvature", material, known)
    return sum(curvatures, np.zeros_like(hinges))[0]
