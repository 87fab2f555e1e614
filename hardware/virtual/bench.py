"""The bench: arm and camera of one scene, on a clock that does not wait.

Arm and camera share what happened: `perform` moves the joints and, with them, a string
other than the model's (in points, integrator and step); `stop` films it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, SPEEDS
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
from stringcast.stages.model.engine.integrators import RungeKutta4
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String

EXPOSURE_MOMENTS = 5  # moments drawn in one exposure


@dataclass(frozen=True)
class Specimen:
    """The string on a virtual bench.

    length: [m]. parameters: the paper's, per mass point at n = 10. points: of the
    simulation. hidden: effects beyond them, on the string, in the hand, the camera or
    their clocks, by name, each with its parameters.
    """

    length: float
    parameters: Mapping[str, float]
    points: int = 40
    hidden: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse to hide what is not known."""
        for effect in find_effects(list(self.hidden)):
            unknown = set(self.hidden[effect.name]) - {
                p.name for p in effect.parameters
            }
            if unknown:
                known = ", ".join(p.name for p in effect.parameters)
                raise ValueError(
                    f"effect '{effect.name}' has no parameter '{unknown.pop()}'. Known are: {known}"
                )

    @property
    def parameter_values(self) -> dict[str, float]:
        """Values of the string's and of the hidden effects' parameters, by qualified
        name.
        """
        hidden = {
            f"{effect}.{name}": size
            for effect, own in self.hidden.items()
            for name, size in own.items()
        }
        return {**self.parameters, **hidden}

    def string(self) -> String:
        """The fine string that hangs from the hand."""
        return String(
            self.length,
            points=self.points,
            tip_cell=0.5,
            grasp_cell=0.5,
            integrator=RungeKutta4(),
            largest_step=1e-4,
        )


@dataclass
class VirtualBench:
    """A lab in a box. seed: of everything that happens by chance; `count` keeps trials
    apart.
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
        """The true model: the fine string in this arm's hand, with all that is hidden,
        among the obstacles.
        """
        hidden = Model(self.specimen.string(), self.arm, self.camera).with_effects(
            *find_effects(list(self.specimen.hidden))
        )
        return hidden.with_effects(*self.obstacles.effects)

    @property
    def values(self) -> np.ndarray:
        """The true parameters, (1, P)."""
        return self.model.values(
            {**self.specimen.parameter_values, **self.obstacles.parameter_values}
        )[None]

    def random_generator(self, purpose: int) -> np.random.Generator:
        """Chance for one purpose in the trial at hand."""
        return np.random.default_rng([self.seed, self.trial_number, purpose])

    def string_at(self, times: np.ndarray) -> np.ndarray:
        """The true string at times, (F, n, 2) [m]."""
        return self.model.simulate_string(
            self._commanded_motion(0.001), self.values, times
        ).points[0]

    def joints_at(self, times: np.ndarray) -> np.ndarray:
        """The true arm at times, (F, J + 1, 2) [m]."""
        motion = self.model.joint_motion(
            self._commanded_motion(self.servo.step), self.values
        )
        t = motion.start + motion.tick * np.arange(motion.angles.shape[1])
        return self.arm.joint_positions(
            np.stack(
                [np.interp(times, t, angle) for angle in motion.angles[0].T], axis=-1
            )
        )

    def _commanded_motion(self, tick: float) -> JointMotion:
        """The commanded motion of the joints, every `tick` [s]."""
        if self.performed_motion is None:
            raise HardwareError(
                "virtual bench: nothing has been performed. Perform a motion before filming it."
            )
        return resample_joint_motion(*self.performed_motion, tick=tick)

    def camera_view(
        self, true: Callable[[np.ndarray], np.ndarray], times: np.ndarray
    ) -> np.ndarray:
        """Points as the camera reports them at its own times, (F, n, 2) [m]. true: the
        points at true times (M,).
        """
        model, values = self.model, self.values
        points = true(model.required_times(values, times).ravel())
        return model.observed_points(points[None], values, times)[0]


@dataclass
class VirtualArm:
    """The bench's arm; fills `stages.execute.interfaces.ArmDevice`."""

    bench: VirtualBench

    def __enter__(self) -> Self:
        """Nothing to open."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing moves on its own."""

    def angles(self) -> np.ndarray:
        """Angles after the last movement, (J,) [rad]; zero before the first."""
        return (
            np.zeros(len(self.bench.arm.links))
            if self.bench.pose is None
            else self.bench.pose
        )

    def check(self, commands: pd.DataFrame) -> None:
        """Accept every motion: nothing can break."""

    def move_to(self, angles: Sequence[float]) -> None:
        """Be at these angles (J,) [rad], the string at rest."""
        self.bench.pose = np.asarray(angles, dtype=float)
        self.bench.trial_number += 1

    def perform(self, commands: pd.DataFrame) -> Performance:
        """Play the commands through the velocity loop."""
        bench = self.bench
        if bench.pose is None:
            raise HardwareError(
                "virtual arm: it is nowhere yet. Call move_to before perform."
            )
        t, speeds = commands["t"].to_numpy(), commands[list(SPEEDS)].to_numpy()
        fine, turned = bench.servo.follow_commands(t, speeds, bench.random_generator(1))
        bench.performed_motion = (fine, bench.pose + turned)
        reported = np.stack(
            [np.interp(t, fine, bench.pose[j] + turned[:, j]) for j in range(3)],
            axis=-1,
        )
        measured = dict(
            zip(JOINTS, bench.servo.encoder_reading(reported).T, strict=True)
        )
        # tables as a good link would give them: commands late by tens of microseconds
        late = np.abs(bench.random_generator(2).normal(0, 4e-5, len(t)))
        times = {
            "t_due": t,
            "t_sent": t + late,
            "t_acknowledged": t + late + 8e-4,
            "t_device": t,
        }
        asked = dict(zip(SPEEDS, speeds.T, strict=True))
        ticks = pd.DataFrame(
            {"tick": np.arange(len(t))} | times | asked | measured | {"missed": False}
        )
        p50, p99 = np.percentile(late, [50, 99])
        jitter = {"jitter_p50": [p50], "jitter_p99": [p99], "jitter_max": [late.max()]}
        link = pd.DataFrame(
            {"valid": [True], "reason": [""], "ticks": [len(t)], "missed": [0]} | jitter
        )
        return Performance(
            pd.DataFrame({"t": t} | measured), ticks, link, started_at=0.0
        )


@dataclass
class VirtualCamera:
    """The bench's camera; fills `stages.execute.interfaces.CameraDevice`."""

    bench: VirtualBench

    def __enter__(self) -> Self:
        """Nothing to open."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing to close."""

    def start(self) -> None:
        """Begin filming."""

    def stop(self, moved_at: float) -> Recording:
        """Film what was performed. The bench's clock is the movement's; `moved_at` is
        not needed.
        """
        bench, camera = self.bench, self.bench.camera
        if bench.performed_motion is None:
            raise HardwareError(
                "virtual camera: nothing was performed. Perform a motion before filming it."
            )
        first, last = bench.performed_motion[0][[0, -1]]
        t = (
            np.arange(
                np.ceil(first * camera.fps - 1e-6),
                np.floor(last * camera.fps + 1e-6) + 1,
            )
            / camera.fps
        )
        open_shutter = np.linspace(-0.5, 0.5, EXPOSURE_MOMENTS) * camera.exposure
        moments = np.clip(t[:, None] + open_shutter, first, last).ravel()
        strings = bench.camera_view(bench.string_at, moments).reshape(
            len(t), EXPOSURE_MOMENTS, -1, 2
        )
        joints = bench.camera_view(bench.joints_at, moments).reshape(
            len(t), EXPOSURE_MOMENTS, -1, 2
        )
        wall = render_background(camera, bench.look, bench.seed)
        rng = bench.random_generator(3)
        images = [
            add_sensor_noise(
                render_frame(camera, bench.look, j, s, wall), bench.look, rng
            )
            for j, s in zip(joints, strings, strict=True)
        ]
        return Recording(t, images)
