"""An executor that casts on the virtual lab and measures points without filming.

This takes less time than filming. The lab's string differs from the model's (more
points, another integrator), or a reference simulator moves it (`worlds.py`). Its arm has a velocity loop and repeats itself only approximately.
Only the camera's picture is left out: points have the noise of extraction.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.artifacts import (
    FRAMES,
    JOINTS,
    MASKS,
    POINTS,
    READINGS,
    Points,
    Trial,
)
from stringcast.hardware.virtual.bench import VirtualBench
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Iteration, Step
from stringcast.stages.execute.execute import pad_commands
from stringcast.stages.hit_test import HitResult, hit_test
from tests.benchmarks.casting.worlds import World

TRUTH_STEP_S = 1e-3  # time step at which the true string is compared with the target
MARKERS = 20  # about as many points of the lab's string are measured


@dataclass
class PointExecutor:
    """Makes the steps of casts in memory.

    Attributes
    ----------
    experiment
        Settings and stages of the run.
    noise
        Standard deviation of a measured coordinate [m].
    world
        Reference simulator in place of the lab's string; None for the lab's string.
    seconds
        Processor time of each stage, by number of the cast and name of the stage.
    benches
        The virtual lab of each cast, by its number.
    """

    experiment: Experiment
    noise: float
    world: World | None = None
    seconds: dict[tuple[int, str], float] = field(default_factory=dict)
    benches: dict[int, VirtualBench] = field(default_factory=dict)

    def obtain(self, step: Step) -> Any:
        """Make the artifact of a step."""
        if step.stage.name == "execute":
            return self._perform(step)
        if step.stage.name == "extract":
            return self._measure(step)
        started = time.process_time()
        artifact = self.experiment.run_step(step, lambda share: None)
        self.seconds[step.number, step.stage.name] = time.process_time() - started
        return artifact

    def _perform(self, step: Step) -> Trial:
        settings = self.experiment.config["execute"]
        arm: Any = self.experiment.lab(step.number).arm
        commands = pad_commands(
            step.inputs["motion"].commands, settings["before"], settings["after"]
        )
        arm.move_to(commands[list(JOINTS)].iloc[0].tolist())
        performance = arm.perform(commands)
        bench = arm.bench
        self.benches[step.number] = (
            bench if self.world is None else self.world.replace_string(bench)
        )
        return Trial(
            performance.arm, performance.ticks, FRAMES.empty(), performance.link, []
        )

    def _measure(self, step: Step) -> Points:
        """Measure points at the frames of a camera that films throughout the trial."""
        first, last = step.inputs["trial"].arm["t"].iloc[[0, -1]]
        fps = self.experiment.camera.fps
        t = np.arange(np.ceil(first * fps), np.floor(last * fps) + 1) / fps
        rng = np.random.default_rng([self.experiment.seed, step.number])
        return measure_points(self.benches[step.number], t, self.noise, rng)

    def true_outcome(self, number: int, duration: float) -> HitResult:
        """Return the true outcome of a cast, whatever was measured of it.

        `duration` is that of its movement [s].
        """
        t = np.arange(0, duration + TRUTH_STEP_S, TRUTH_STEP_S)
        bench = self.benches[number]
        truth = string_as_points(bench, t, bench.string_at(t), 0.0)
        return hit_test(
            truth, self.experiment.target, self.experiment.obstacles, duration
        )

    def publish(self, iterations: list[Iteration]) -> None:
        """Do nothing, because the casts of a job are no dataset."""


def measure_points(
    bench: VirtualBench, t: np.ndarray, noise: float, rng: np.random.Generator
) -> Points:
    """Return the points that extraction would read of a lab's string at times (F,) [s].

    `noise` is the standard deviation of a coordinate [m].
    """
    seen = bench.camera_view(bench.string_at, t)
    return string_as_points(
        bench, t, seen + noise * rng.standard_normal(seen.shape), noise
    )


def string_as_points(
    bench: VirtualBench, t: np.ndarray, string: np.ndarray, sigma: float
) -> Points:
    """Return a lab's string (F, n, 2) [m] at times (F,) [s] as points.

    `sigma` is the stated uncertainty of a coordinate [m].
    """
    spacing = max(bench.specimen.points // MARKERS, 1)
    string = string[:, ::-spacing][:, ::-1]
    s = bench.specimen.string().arc_lengths()[::-spacing][::-1]
    points = {
        "t": t.repeat(len(s)),
        "s": np.tile(s, len(t)),
        "x": string[..., 0].ravel(),
        "y": string[..., 1].ravel(),
        "sigma": sigma,
        "valid": True,
    }
    readings = {
        "frame": np.arange(len(t)),
        "t": t,
        "valid": True,
        "reason": "",
        "tip_x": string[:, -1, 0],
        "tip_y": string[:, -1, 1],
        "tip_sigma": sigma,
        "length": bench.specimen.length,
    }
    return Points(
        POINTS.check(pd.DataFrame(points)),
        READINGS.check(pd.DataFrame(readings)),
        MASKS.empty(),
    )
