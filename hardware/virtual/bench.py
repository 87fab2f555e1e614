"""The virtual bench: arm and camera of one scene, simulated without waiting.

`perform` moves the joints and, with them, a string on a mesh so fine that its values
are those of a continuous string; `stop` films it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Self

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import JOINTS, SPEEDS, lateness_columns
from stringcast.hardware.virtual.obstacles import Obstacles
from stringcast.hardware.virtual.render import (
    Look,
    add_sensor_noise,
    render_background,
    render_frame,
)
from stringcast.hardware.virtual.servo import VirtualServo
from stringcast.stages.execute.interfaces import HardwareError, Performance, Recording
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String

EXPOSURE_MOMENTS = 5  # moments rendered in one exposure
STEP_S = 5e-5  # of the true string


@dataclass(frozen=True)
class Specimen:
    """The string on a virtual bench.

    Attributes
    ----------
    length
        Its length [m].
    parameters
        The paper's parameters, per mass point at n = 10.
    points
        Mass points of the simulation.
    hidden
        Further effects on string, hand, camera or clocks, by name, each with its
        parameters.
    """

    length: Annotated[float, Field(gt=0, le=100.0)]
    parameters: Mapping[str, float]
    points: int = 160
    hidden: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse hidden effects and parameters that do not exist."""
        for effect in find_effects(list(self.hidden)):
            names = [parameter.name for parameter in effect.parameters]
            for name in self.hidden[effect.name]:
                if name not in names:
                    raise ValueError(
                        f"effect '{effect.name}' has no parameter '{name}'. "
                        f"Known are: {', '.join(names)}"
                    )

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of all parameters of the string and of hidden effects, by name."""
        values = dict(self.parameters)
        for effect, parameters in self.hidden.items():
            values |= {f"{effect}.{name}": parameters[name] for name in parameters}
        return values

    def string(self) -> String:
        """Make the fine string that hangs from the hand."""
        return String(
            self.length,
            points=self.points,
            tip_cell=0.5,
            grasp_cell=0.5,
            integrator=ImplicitLeapfrog(),
            largest_step=STEP_S,
        )


@dataclass
class VirtualBench:
    """The arm, camera, specimen and servo of a virtual lab.

    Attributes
    ----------
    arm, camera
        The arm and the camera.
    specimen
        The string.
    seed, trial_number
        Seeds of all random events.
    servo
        The velocity loop of the joints.
    look
        The appearance of the scene.
    obstacles
        Boxes that the string can hit.
    pose : (J,)
        Joint angles before the motion [rad].
    performed_motion
        Times (K,) [s] and joint angles (K, J) [rad] of the last motion.
    """

    arm: Arm
    camera: Camera
    specimen: Specimen
    seed: int
    servo: VirtualServo = field(default_factory=VirtualServo)
    look: Look = field(default_factory=Look)
    obstacles: Obstacles = field(default_factory=Obstacles)
    trial_number: int = 0
    pose: np.ndarray | None = None
    performed_motion: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def model(self) -> Model:
        """The true model: the fine string with all hidden effects and obstacles."""
        model = Model(self.specimen.string(), self.arm, self.camera)
        model = model.with_effects(*find_effects(list(self.specimen.hidden)))
        return model.with_effects(*self.obstacles.effects)

    @property
    def values(self) -> np.ndarray:
        """The true parameters, (1, P)."""
        values = self.specimen.parameter_values | self.obstacles.parameter_values
        return self.model.values(values)[None]

    def random_generator(self, purpose: int) -> np.random.Generator:
        """Make the random generator for one purpose in this trial."""
        return np.random.default_rng([self.seed, self.trial_number, purpose])

    def string_at(self, times: np.ndarray) -> np.ndarray:
        """Simulate the true string at times (F,) [s], (F, n, 2) [m]."""
        motion = self._commanded_motion(0.001)
        simulated = self.model.simulate_string(motion, self.values, times)
        return simulated.points[0]

    def joints_at(self, times: np.ndarray) -> np.ndarray:
        """Compute the true arm at times (F,) [s], (F, J + 1, 2) [m]."""
        commanded = self._commanded_motion(self.servo.step)
        motion = self.model.joint_motion(commanded, self.values)
        angles = interpolate_rows(times, motion.times, motion.angles[0])
        return self.arm.joint_positions(angles)

    def _commanded_motion(self, tick: float) -> JointMotion:
        """Sample the performed motion of the joints every `tick` [s]."""
        assert self.performed_motion is not None
        return resample_joint_motion(*self.performed_motion, tick=tick)

    def camera_view(
        self, true: Callable[[np.ndarray], np.ndarray], times: np.ndarray
    ) -> np.ndarray:
        """Compute points as reported by the camera at times of its clock.

        Parameters
        ----------
        true
            Returns the points (M, n, 2) [m] at true times (M,) [s].
        times : (F,)
            Times of the camera's clock [s].

        Returns
        -------
        (F, n, 2) ndarray
            The reported points [m].
        """
        model, values = self.model, self.values
        points = true(model.required_times(values, times).ravel())
        return model.observed_points(points[None], values, times)[0]


@dataclass
class VirtualArm:
    """The bench's arm; implements `ArmDevice`."""

    bench: VirtualBench

    def __enter__(self) -> Self:
        """Do nothing: there is no device to open."""
        return self

    def __exit__(self, *error: object) -> None:
        """Do nothing: no device has to be stopped."""

    def angles(self) -> np.ndarray:
        """Return the angles after the last movement, (J,) [rad]; zero at first."""
        if self.bench.pose is None:
            return np.zeros(len(self.bench.arm.links))
        return self.bench.pose

    def check(self, commands: pd.DataFrame) -> None:
        """Accept every motion of the virtual arm."""

    def move_to(self, angles: Sequence[float]) -> None:
        """Move to angles (J,) [rad], with the string at rest."""
        self.bench.pose = np.asarray(angles, dtype=float)
        self.bench.trial_number += 1

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Play the commands through the velocity loop."""
        bench = self.bench
        if bench.pose is None:
            raise HardwareError(
                "virtual arm",
                "it is nowhere yet",
                "Call move_to before perform.",
            )
        t, speeds = commands["t"].to_numpy(), commands[list(SPEEDS)].to_numpy()
        fine, turned = bench.servo.follow_commands(t, speeds, bench.random_generator(1))
        angles = bench.pose + turned
        bench.performed_motion = (fine, angles)
        reported = interpolate_rows(t, fine, angles)
        encoders = bench.servo.encoder_reading(reported)
        measured = dict(zip(JOINTS, encoders.T, strict=True))
        # tables of a good link: commands late by tens of microseconds
        late = np.abs(bench.random_generator(2).normal(0, 4e-5, len(t)))
        ticks = {
            "tick": np.arange(len(t)),
            "t_due": t,
            "t_sent": t + late,
            "t_acknowledged": t + late + 8e-4,
            "t_device": t,
            **dict(zip(SPEEDS, speeds.T, strict=True)),
            **measured,
            "missed": False,
        }
        link = {"valid": True, "reason": "", "ticks": len(t), "missed": 0}
        link |= lateness_columns("jitter", late)
        return Performance(
            pd.DataFrame({"t": t} | measured),
            pd.DataFrame(ticks),
            pd.DataFrame([link]),
            started_at=0.0,
        )


@dataclass
class VirtualCamera:
    """The bench's camera; implements `CameraDevice`."""

    bench: VirtualBench

    def __enter__(self) -> Self:
        """Do nothing: there is no device to open."""
        return self

    def __exit__(self, *error: object) -> None:
        """Do nothing: there is no device to close."""

    def start(self) -> None:
        """Do nothing: `stop` films the whole motion."""

    def stop(self, moved_at: float) -> Recording:
        """Film the performed motion.

        `moved_at` is not used, as the bench uses the movement's clock.
        """
        bench, camera = self.bench, self.bench.camera
        if bench.performed_motion is None:
            raise HardwareError(
                "virtual camera",
                "nothing was performed",
                "Perform a motion before filming it.",
            )
        first, last = bench.performed_motion[0][[0, -1]]
        first_frame = np.ceil(first * camera.fps - 1e-6)
        last_frame = np.floor(last * camera.fps + 1e-6)
        t = np.arange(first_frame, last_frame + 1) / camera.fps
        open_shutter = np.linspace(-0.5, 0.5, EXPOSURE_MOMENTS) * camera.exposure
        moments = np.clip(t[:, None] + open_shutter, first, last).ravel()
        shape = len(t), EXPOSURE_MOMENTS, -1, 2
        strings = bench.camera_view(bench.string_at, moments).reshape(shape)
        joints = bench.camera_view(bench.joints_at, moments).reshape(shape)
        wall = render_background(camera, bench.look, bench.seed)
        rng = bench.random_generator(3)
        images = []
        for arm, string in zip(joints, strings, strict=True):
            frame = render_frame(camera, bench.look, arm, string, wall)
            images.append(add_sensor_noise(frame, bench.look, rng))
        return Recording(t, images)
