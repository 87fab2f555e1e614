"""Simulated trials in which a misaligned camera sees a swinging arm."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    JOINTS,
    MASKS,
    POINTS,
    READINGS,
    SPEEDS,
    Motion,
    Observation,
)
from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.align.excitation.excite import excite
from stringcast.stages.align.fit import measurement_model
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model

SWING = {"duration": 4.0, "speed": 2.0, "highest": 2.5, "sines": 3, "motions": 8}
MISALIGNMENT = {
    "time_offset.offset": 0.0123,
    "camera_rotation.angle": 0.02,
    "pixel_scale.excess": -0.01,
    "camera_offset.x": 0.012,
    "camera_offset.y": -0.008,
}


def found_values(alignment):
    """Return the detected parameters of an alignment, by qualified name."""
    rows = alignment.measured[alignment.measured["found"]]
    return dict(zip(rows["name"], rows["value"], strict=True))


@dataclass(frozen=True)
class AlignmentBench:
    """A motion of an arm in front of a camera."""

    model: Model
    motion: Motion
    seed: int

    @cached_property
    def _performed(self) -> tuple[pd.DataFrame, JointMotion]:
        servo, commands = VirtualServo(), self.motion.commands
        start, t = commands[list(JOINTS)].to_numpy()[0], commands["t"].to_numpy()
        fine, turned = servo.follow_commands(
            t, commands[list(SPEEDS)].to_numpy(), np.random.default_rng([self.seed, 1])
        )
        measured = interpolate_rows(t, fine, start + turned)
        report = dict(zip(JOINTS, servo.encoder_reading(measured).T, strict=True))
        return pd.DataFrame({"t": t} | report), resample_joint_motion(
            fine, start + turned, 0.001
        )

    @property
    def arm(self) -> pd.DataFrame:
        """Return the reported joint angles, as table ARM."""
        return self._performed[0]

    def joints(self, true, fps, extra_effects=()):
        """Return frame times (F,) and the seen joint positions (F, J + 1, 2).

        `true` holds the true alignment by qualified name.
        """
        model = measurement_model(self.model).with_effects(*find_effects(extra_effects))
        times = np.arange(0.0, self.motion.duration, 1 / fps)
        return times, model.observed_arm(
            self._performed[1], model.values(true)[None], times
        )[0]

    def observation(
        self, true, fps=60.0, sigma=1e-3, correlation=0.0, extra_effects=(), name="t01"
    ):
        """Return the hand as observed points at s = 0.

        `correlation` is that of the noise from one frame to the next.
        """
        t, joints = self.joints(true, fps, extra_effects)
        white = np.random.default_rng([self.seed, 2]).normal(size=(len(t) + 200, 2))
        noise = np.sqrt(1 - correlation**2) * white
        for number in range(1, len(noise)):
            noise[number] += correlation * noise[number - 1]
        x, y = (joints[:, -1] + sigma * noise[200:]).T
        points = pd.DataFrame(
            {"t": t, "s": 0.0, "x": x, "y": y, "sigma": sigma, "valid": True}
        )
        return Observation(
            name, POINTS.check(points), READINGS.empty(), MASKS.empty(), arm=self.arm
        )


def build_bench(model: Model, seed: int = 0, **swing) -> AlignmentBench:
    """Build a bench with a motion drawn from a seed."""
    return AlignmentBench(
        model, excite(model, (), seed=seed, **{**SWING, **swing}), seed
    )


def without_motion(observation: Observation) -> Observation:
    """Return the observation of an arm that does not move."""
    first = observation.points.iloc[0]
    arm = observation.arm.assign(**observation.arm[list(JOINTS)].iloc[0])
    return replace(
        observation,
        arm=arm,
        points=observation.points.assign(x=first["x"], y=first["y"]),
    )
