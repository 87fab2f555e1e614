"""An executor that casts on the virtual bench and measures points instead of filming:
the same loop for less time.

The bench's string is another than the model's (40 points, another integrator), its arm
has a velocity loop and repeats itself only nearly. What is left out is the camera's
picture: points have the noise that extraction leaves.
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

FINE = 1e-3  # [s] between moments at which it is looked up what really happened
PLACES = 2  # every so manieth point of the bench's string is measured


@dataclass
class PointExecutor:
    """Steps are made in memory. noise: of a measured coordinate, one sigma [m].
    seconds: that planning took, and the bench, by number of the cast.
    """

    experiment: Experiment
    noise: float
    seconds: dict[int, float] = field(default_factory=dict)
    benches: dict[int, VirtualBench] = field(default_factory=dict)

    def obtain(self, step: Step) -> Any:
        """The artifact of a step."""
        here, stage = self.experiment, step.stage.name
        if stage == "execute":
            rest = here.config["execute"]
            arm: Any = here.lab(step.number).arm
            commands = pad_commands(
                step.inputs["motion"].commands, rest["before"], rest["after"]
            )
            arm.move_to(commands[list(JOINTS)].iloc[0].tolist())
            performance = arm.perform(commands)
            self.benches[step.number] = arm.bench
            return Trial(
                performance.arm, performance.ticks, FRAMES.empty(), performance.link, []
            )
        if stage == "extract":  # as from the frames of a camera that films throughout
            first, last = step.inputs["trial"].arm["t"].iloc[[0, -1]]
            rate = here.camera.fps
            t = np.arange(np.ceil(first * rate), np.floor(last * rate) + 1) / rate
            chance = np.random.default_rng([here.seed, step.number])
            return measured(self.benches[step.number], t, self.noise, chance)
        begun = time.process_time()
        made = here.run_step(step, lambda share: None)
        if stage == "generate":
            self.seconds[step.number] = time.process_time() - begun
        return made

    def real(self, number: int, duration: float) -> HitResult:
        """The true outcome of a cast, whatever was seen of it. duration: of its
        movement [s].
        """
        t = np.arange(0, duration + FINE, FINE)
        bench = self.benches[number]
        seen = read(bench, t, bench.string_at(t), 0.0)
        return hit_test(
            seen, self.experiment.target, self.experiment.obstacles, duration
        )

    def publish(self, iterations: list[Iteration]) -> None:
        """Do nothing: a job's casts are no dataset."""


def measured(
    bench: VirtualBench, t: np.ndarray, noise: float, rng: np.random.Generator
) -> Points:
    """The points that extraction would read of a bench's string at times (F,) [s].
    noise: of a coordinate, one sigma [m].
    """
    seen = bench.camera_view(bench.string_at, t)
    return read(bench, t, seen + noise * rng.standard_normal(seen.shape), noise)


def read(
    bench: VirtualBench, t: np.ndarray, string: np.ndarray, sigma: float
) -> Points:
    """A bench's string (F, n, 2) [m] at times (F,) [s] as points. sigma: stated of a
    coordinate [m].
    """
    string, s = (
        string[:, ::-PLACES][:, ::-1],
        bench.specimen.string().arc_lengths()[::-PLACES][::-1],
    )
    columns: dict[str, Any] = {"t": t.repeat(len(s)), "s": np.tile(s, len(t))}
    columns |= {
        "x": string[..., 0].ravel(),
        "y": string[..., 1].ravel(),
        "sigma": sigma,
        "valid": True,
    }
    tips: dict[str, Any] = {
        "frame": np.arange(len(t)),
        "t": t,
        "valid": True,
        "reason": "",
    }
    tips |= {
        "tip_x": string[:, -1, 0],
        "tip_y": string[:, -1, 1],
        "tip_sigma": sigma,
        "length": bench.specimen.length,
    }
    return Points(
        POINTS.check(pd.DataFrame(columns)),
        READINGS.check(pd.DataFrame(tips)),
        MASKS.empty(),
    )
