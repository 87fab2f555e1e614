"""One run of a hit study: a string of the bench cast at a target in one way, from one
seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import Diagnosis, TrialSet
from stringcast.hardware.virtual.bench import VirtualBench
from stringcast.pipeline.modes import Cast
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.iterations import History, Iteration
from stringcast.pipeline.studies.hitting.executor import PointExecutor
from stringcast.stages.generate.curves import first_curves
from stringcast.stages.generate.generate import MotionNotFoundError, arm_faults
from stringcast.stages.model.hand import JointMotion

Config = Mapping[str, Any]
REFERENCES = 4  # casts on which a model's prediction is measured, the same for all
REFERENCE_T = (0.3, 1.0)  # [s]
REFERENCE_ALPHA = 75.0  # [rad/s^2]

PERFORMED = ("generate", "execute", "extract")  # of a lesson


def settings(
    config: Config, case: Config, method: Config, seed: int, casts: int
) -> dict[str, Any]:
    """Settings of one run: those of the study, with what differs in the case (such as
    `specimen`) and in the method (such as `generate`).
    """
    own = {name: value for name, value in config.items() if name != "hits"}
    for block, differs in (*case.items(), *method.items()):
        own[block] = _changed(own[block], differs)
    bench = {
        "specimen": own["specimen"],
        "obstacles": {**own["hardware"]["obstacles"], **own["obstacles"]},
    }
    own["hardware"] = {**own["hardware"], **bench}
    cast = {
        "_target_": "pipeline.modes.Cast",
        "stages": ["generate", "execute", "extract", "estimate"],
    }
    return own | {"seed": seed, "manipulations": casts, "mode": cast}


def _changed(block: Any, differs: Any) -> Any:
    """A block of settings with what differs; another stage comes with all of its own."""
    if (
        not (isinstance(differs, Mapping) and isinstance(block, Mapping))
        or "_target_" in differs
    ):
        return differs
    return {
        **block,
        **{name: _changed(block.get(name), value) for name, value in differs.items()},
    }


def casts_of(
    config: Config, case: Config, method: Config, seed: int
) -> list[dict[str, Any]]:
    """A row for each cast that counts, until the loop believes that one has hit.
    config: settings of the study; its `hits.lessons` are cast before, the same for all
    methods. A method with settings of a stage `diagnose` goes on with the model that
    this makes of them.
    """
    hits = config["hits"]
    count, noise = hits["lessons"]["casts"], hits["noise"]
    taught_so = {name: hits["lessons"][name] for name in ("generate", "target")}
    plain = settings(config, case, taught_so, seed, hits["casts"])
    own = settings(config, case, method, seed, hits["casts"] + count)
    try:
        taught = lessons(PointExecutor(prepare_experiment(plain, named), noise), count)
        if "diagnose" in method:
            found = model_found(
                prepare_experiment({**plain, "diagnose": method["diagnose"]}, named),
                taught,
            )
            own |= {
                block: _changed(own[block], value) for block, value in found.items()
            }
        here = prepare_experiment(own, named)
        executor = PointExecutor(here, noise)
        if taught:
            # their last iteration keeps the result
            History(executor, taught).make_artifact("estimate", trials=_seen(taught))
        assert isinstance(here.mode, Cast)
        made = here.mode.run_steps(here, Path(), executor, taught).iterations[count:]
    except MotionNotFoundError as error:
        # the run counts as one that never hits
        return [{"cast": 1, "hit": False, "reason": str(error)}]
    truth = References(here, next(iter(executor.benches.values())))
    return [_row(i, i.number - count, executor, truth) for i in made]


def lessons(executor: PointExecutor, count: int) -> list[Iteration]:
    """First casts, each as if nothing were known of the string; what is cast after them
    is no change of theirs.
    """
    history = History(executor)
    for _ in range(count):
        current = history.begin_iteration()
        for name in PERFORMED:
            history.make_artifact(name)
        del current.artifacts["motion"]
    return history.iterations


def model_found(here: Experiment, casts: list[Iteration]) -> dict[str, Any]:
    """Settings of the model that a diagnosis of the lessons makes: what `extended=<its
    folder>` brings along.
    """
    taught = [*casts[:-1], replace(casts[-1], artifacts=dict(casts[-1].artifacts))]
    made: Diagnosis = History(PointExecutor(here, noise=0.0), taught).make_artifact(
        "diagnose", trials=_seen(casts)
    )
    said: dict[str, Any] = yaml.safe_load(made.finding["extended"].iloc[0])
    return said


def _seen(casts: list[Iteration]) -> TrialSet:
    return TrialSet(tuple(cast.observation for cast in casts))


def named(block: str) -> str:
    """The place in the settings that a block comes from, for messages."""
    return f"conf/{block}"


def _row(
    iteration: Iteration, number: int, executor: PointExecutor, truth: References
) -> dict[str, Any]:
    assert iteration.verdict is not None
    plan, estimate = (
        iteration.artifacts["motion"].outcome.iloc[0],
        iteration.artifacts["estimate"],
    )
    real = executor.real(iteration.number, float(plan["duration"]))
    row = {
        "cast": number,
        "hit": real.hit,
        "believed": iteration.has_hit,
        "distance": real.distance,
        "chance": float(plan.get("chance", np.nan)),
        "planning": executor.seconds[iteration.number],
        "residual": float(estimate.fit["rms_after"].iloc[0]),
        "foretelling": truth.off(estimate.values()),
        "effects": " ".join(executor.experiment.config["effects"]),
    }
    # JSON has no NaN
    return {name: None if pd.isna(value) else value for name, value in row.items()}


class References:
    """Casts that nobody learns from, on which a model predicts the tip."""

    def __init__(self, here: Experiment, bench: VirtualBench) -> None:
        self.model = here.model
        curves = first_curves(
            here.arm, np.random.default_rng(0), 64, REFERENCE_T, REFERENCE_ALPHA
        )
        angles, speeds = curves.sample(here.arm.tick, REFERENCE_T[1])
        some = np.flatnonzero(arm_faults(here.arm, (), angles, speeds) == "")[
            :REFERENCES
        ]
        self.motion = JointMotion(0.0, here.arm.tick, angles[some], speeds[some])
        self.times = np.arange(0, REFERENCE_T[1], 2 * here.arm.tick)
        values = np.repeat(bench.values, REFERENCES, axis=0)
        self.tips = bench.model.simulate_string(self.motion, values, self.times).tip

    def off(self, values: Mapping[str, float]) -> float:
        """Root mean square distance of the predicted tip from the true one [m]."""
        own = np.repeat(self.model.values(values)[None], REFERENCES, axis=0)
        tips = self.model.simulate_string(self.motion, own, self.times).tip
        return float(np.sqrt(np.mean(np.sum((tips - self.tips) ** 2, axis=-1))))
