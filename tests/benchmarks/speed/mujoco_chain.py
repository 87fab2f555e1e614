"""The cord in MuJoCo: a planar chain of rigid links on hinges.

The hinges have stiffness and damping. The hand is a carriage on two slides and a hinge,
a million times as heavy as the cord, so that the cord does not move it. At each step a
force moves it to the next pose. That costs less than a weld to a moving frame, and is
exact. Contacts and constraints are off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from tests.benchmarks.speed.cord import CORD, TIMES, hand_pose

CARRIAGE_MASS = 1e4  # [kg], [kg m^2]

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="{integrator}" gravity="0 -9.81 0">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body gravcomp="1">
      <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
      <joint name="x" type="slide" axis="1 0 0" armature="{carriage}"/>
      <joint name="y" type="slide" axis="0 1 0" armature="{carriage}"/>
      <joint name="theta" type="hinge" axis="0 0 1" armature="{carriage}"/>
      {chain}
    </body>
  </worldbody>
  <actuator><motor joint="x"/><motor joint="y"/><motor joint="theta"/></actuator>
  <sensor><framepos objtype="site" objname="tip"/></sensor>
</mujoco>
"""

LINK = """
<body pos="{start} 0 0">
  <joint type="hinge" axis="0 0 1" stiffness="{stiffness}" damping="{damping}"/>
  <inertial pos="{middle} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
"""


@dataclass(frozen=True)
class Chain:
    """A chain of rigid links.

    `links` is their number. `step` [s] is a whole part of a camera frame.
    """

    links: int
    step: float
    # as exact here as implicitfast and 5 % faster; implicit takes four times as long
    integrator: str = "Euler"

    @cached_property
    def model(self) -> mujoco.MjModel:
        """Return the compiled model.

        Its positions are the carriage's pose and the hinges' angles.
        """
        length = CORD.length / self.links
        chain = "".join(self._link(i, length) for i in range(self.links))
        chain += f'<site name="tip" pos="{length} 0 0"/>' + "</body>" * self.links
        return mujoco.MjModel.from_xml_string(
            MODEL.format(
                step=self.step,
                integrator=self.integrator,
                carriage=CARRIAGE_MASS,
                chain=chain,
            )
        )

    def _link(self, i: int, length: float) -> str:
        """Add one link; the hinge at the clamp has only half a link to bend."""
        cell = length / 2 if i == 0 else length
        return LINK.format(
            start=0.0 if i == 0 else length,
            middle=length / 2,
            stiffness=CORD.bending * CORD.mass / cell,
            damping=CORD.bending_damping * CORD.mass / cell,
            mass=CORD.mass * length,
            inertia=CORD.mass * length**3 / 12,
        )

    @cached_property
    def forces(self) -> np.ndarray:
        """Return forces (1, steps + 1, 3) that move the carriage from pose to pose.

        They are M (p_+1 - 2 p + p_-1) / dt^2. There is one step more than the time
        takes, because a sensor reports the moment at which a step begins.
        """
        steps = round(TIMES[-1] / self.step)
        poses = hand_pose(np.arange(-1, steps + 2) * self.step)
        return CARRIAGE_MASS * np.diff(poses, n=2, axis=0)[None] / self.step**2

    @cached_property
    def start(self) -> np.ndarray:
        """Return the state of the chain at rest in the hand, straight down."""
        data = mujoco.MjData(self.model)
        data.qpos[:3] = hand_pose(0.0)
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, data, state, kind)
        return state

    def prepare_rollout(self, count: int) -> Callable[[], np.ndarray]:
        """Compile the model; return a function that simulates cords on one thread.

        It simulates `count` cords and returns their tips at TIMES, (count, F, 2) [m].
        """
        model, forces = self.model, self.forces
        data = [mujoco.MjData(model)]
        start = np.tile(self.start, (count, 1))
        every = round((TIMES[1] - TIMES[0]) / self.step)

        def run() -> np.ndarray:
            with Rollout(nthread=0) as rollout:
                _, sensors = rollout.rollout(model, data, start, forces)
            return sensors[:, ::every, :2]

        return run
