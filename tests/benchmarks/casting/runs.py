"""One run of a casting study.

One method casts a string of the virtual lab at a target, from one seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from stringcast.data.artifacts import TrialSet
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, Surprise
from stringcast.hardware.virtual.bench import VirtualBench
from stringcast.pipeline.modes import Cast
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.iterations import LOOK_NUMBER, History, Iteration
from stringcast.stages.explain.decision import MIXED_PROBABILITY
from stringcast.stages.generate.curves import first_curves
from stringcast.stages.generate.generate import MotionNotFoundError, arm_faults
from stringcast.stages.model.extension import extend_model
from stringcast.stages.model.hand import JointMotion
from tests.benchmarks.casting.point_executor import PointExecutor
from tests.benchmarks.casting.worlds import World

Config = Mapping[str, Any]
# casts on which prediction errors are measured, the same for all methods
REFERENCE_CASTS = 4
REFERENCE_DURATION_S = (0.3, 1.0)
REFERENCE_ACCELERATION = 75.0  # [rad/s^2]
REFERENCE_STEP_S = 0.01
TRAINING_STAGES = ("generate", "execute", "extract")


def run_settings(
    config: Config, case: Config, method: Config, seed: int, casts: int
) -> dict[str, Any]:
    """Return the settings of a run.

    They are those of the study, changed by the case and by the method.
    """
    settings = {
        name: value
        for name, value in config.items()
        if name not in ("casting", "folder")
    }
    for block, change in (*case.items(), *method.items()):
        settings[block] = merge_change(settings[block], change)
    obstacles = {**settings["hardware"]["obstacles"], **settings["obstacles"]}
    settings["hardware"] = {
        **settings["hardware"],
        "specimen": settings["specimen"],
        "obstacles": obstacles,
    }
    return settings | {"seed": seed, "max_casts": casts}


def merge_change(block: Any, change: Any) -> Any:
    """Merge a change into a settings block.

    A change to another stage replaces the whole block.
    """
    if (
        not (isinstance(change, Mapping) and isinstance(block, Mapping))
        or "_target_" in change
    ):
        return change
    return {
        **block,
        **{
            name: merge_change(block.get(name), value) for name, value in change.items()
        },
    }


def run_casts(
    config: Config, case: Config, method: Config, seed: int, world: World | None
) -> list[dict[str, Any]]:
    """Cast until the loop believes that a cast has hit; return a row for each cast.

    `world` moves the string in place of the lab, unless it is None.

    The training casts of `casting.training` come first and are not counted; they are
    the same for all methods. A method with settings of a stage `diagnose` uses the
    model of a diagnosis of the training casts.
    """
    study = config["casting"]
    count, noise = study["training"]["casts"], study["noise"]
    training_method = {name: study["training"][name] for name in ("generate", "target")}
    training = run_settings(config, case, training_method, seed, study["casts"])
    settings = run_settings(config, case, method, seed, study["casts"] + count)
    try:
        training_casts = perform_training(
            PointExecutor(prepare_experiment(training, settings_file), noise, world),
            count,
        )
        if "diagnose" in method:
            diagnosis = prepare_experiment(
                {**training, "diagnose": method["diagnose"]}, settings_file
            )
            for block, value in diagnosed_model(diagnosis, training_casts).items():
                settings[block] = merge_change(settings[block], value)
        experiment = prepare_experiment(settings, settings_file)
        executor = PointExecutor(experiment, noise, world)
        if training_casts:
            # the last training cast keeps the estimate
            History(executor, training_casts).make_artifact(
                "estimate", trials=trial_set(training_casts)
            )
        assert isinstance(experiment.mode, Cast)
        result = experiment.mode.run_steps(experiment, Path(), executor, training_casts)
    except MotionNotFoundError as error:
        # a run without a motion never hits
        return [{"cast": 1, "hit": False, "reason": str(error)}]
    references = ReferenceCasts(experiment, next(iter(executor.benches.values())))
    rows = []
    for cast in result.iterations:
        if cast.number <= count:  # a training cast, or a look at the string
            continue
        row = cast_row(cast, cast.number - count, executor, references)
        # JSON has no NaN
        rows.append({name: None if pd.isna(x) else x for name, x in row.items()})
    return rows


def perform_training(executor: PointExecutor, count: int) -> list[Iteration]:
    """Perform training casts, each planned without knowledge of the string."""
    history = History(executor)
    for _ in range(count):
        current = history.begin_iteration()
        for name in TRAINING_STAGES:
            history.make_artifact(name)
        # so that no later motion starts from this one
        del current.artifacts["motion"]
    return history.iterations


def diagnosed_model(experiment: Experiment, casts: list[Iteration]) -> dict[str, Any]:
    """Return the settings of the model of a diagnosis of the casts.

    They are those that `model_from=<its folder>` gives.
    """
    copies = [*casts[:-1], replace(casts[-1], artifacts=dict(casts[-1].artifacts))]
    history = History(PointExecutor(experiment, noise=0.0), copies)
    diagnosis: Diagnosis = history.make_artifact("diagnose", trials=trial_set(casts))
    extended: dict[str, Any] = yaml.safe_load(diagnosis.finding["extended"].iloc[0])
    return extended


def trial_set(casts: list[Iteration]) -> TrialSet:
    """Return the observations of casts."""
    return TrialSet(tuple(cast.observation for cast in casts))


def settings_file(block: str) -> str:
    """Return where a settings block comes from, for messages."""
    return f"conf/{block}"


def cast_row(
    cast: Iteration, number: int, executor: PointExecutor, references: ReferenceCasts
) -> dict[str, Any]:
    """Return the row of a cast."""
    assert cast.verdict is not None
    plan = cast.artifacts["motion"].outcome.iloc[0]
    estimate = cast.find(Estimate)  # of an explanation, where there is one
    assert estimate is not None
    truth = executor.true_outcome(cast.number, float(plan["duration"]))
    row = {
        "cast": number,
        "hit": truth.hit,
        "believed": cast.has_hit,
        "distance": truth.distance,
        "probability": float(plan.get("chance", np.nan)),
        "planning": executor.seconds[cast.number, "generate"],
        "learning": time_to_learn(executor, cast.number),
        "looking": time_to_learn(executor, LOOK_NUMBER),
        "residual": float(estimate.fit["rms_after"].iloc[0]),
        "prediction_error": references.prediction_error(estimate.values()),
        "effects": " ".join(executor.experiment.config["effects"]),
    }
    bench = executor.benches[cast.number]
    row["hidden"] = " ".join(bench.specimen.hidden)
    row["hidden_shift"] = hidden_tip_shift(bench, float(plan["duration"]))
    return row | found_in_cast(cast)


def time_to_learn(executor: PointExecutor, number: int) -> float:
    """Return the processor time of a look's motion and of what follows a trial [s]."""
    stages = ("excite", "surprise", "estimate", "explain")
    return sum(executor.seconds.get((number, stage), 0.0) for stage in stages)


def hidden_tip_shift(bench: VirtualBench, duration: float) -> float:
    """Return the rms distance by which hidden causes move the tip in a cast [m].

    `duration` is that of its movement [s]. Those of camera and clock count as well.
    """
    if not bench.specimen.hidden:
        return 0.0
    t = np.arange(0, duration, REFERENCE_STEP_S)
    plain = replace(bench, specimen=replace(bench.specimen, hidden={}))
    tips = [each.camera_view(each.string_at, t)[:, -1] for each in (bench, plain)]
    return float(np.sqrt(np.mean(np.sum((tips[0] - tips[1]) ** 2, axis=-1))))


def found_in_cast(cast: Iteration) -> dict[str, Any]:
    """Return whether a cast surprised, and which causes were found."""
    surprise, explanation = cast.find(Surprise), cast.find(Explanation)
    found: dict[str, Any] = {}
    if surprise is not None:
        found["p_value"] = surprise.p_value
    if explanation is not None:
        found["verdict"] = explanation.verdict
        likely = []
        for name, probability in explanation.causes.items():
            if name and probability >= MIXED_PROBABILITY:
                likely.append(f"{name}={probability:.2f}")
        found["causes"] = " ".join(likely)
    return found


class ReferenceCasts:
    """Casts that are excluded from fits, on which the tip is predicted."""

    def __init__(self, experiment: Experiment, bench: VirtualBench) -> None:
        self.model = experiment.model
        arm = experiment.arm
        rng = np.random.default_rng(0)
        curves = first_curves(
            arm, rng, 64, REFERENCE_DURATION_S, REFERENCE_ACCELERATION
        )
        angles, speeds = curves.sample(arm.tick, REFERENCE_DURATION_S[1])
        feasible = np.flatnonzero(arm_faults(arm, (), angles, speeds) == "")[
            :REFERENCE_CASTS
        ]
        self.motion = JointMotion(0.0, arm.tick, angles[feasible], speeds[feasible])
        self.times = np.arange(0, REFERENCE_DURATION_S[1], REFERENCE_STEP_S)
        fine = np.arange(0, REFERENCE_DURATION_S[1], bench.servo.step)
        performed, _ = curves.select(feasible).sample(bench.servo.step, fine[-1])
        tips = []
        for angles in performed:
            cast = replace(bench, performed_motion=(fine, angles))
            tips.append(cast.string_at(self.times)[:, -1])
        self.tips = np.stack(tips)

    def prediction_error(self, values: Mapping[str, float]) -> float:
        """Return the rms distance of the predicted tip from the true one [m]."""
        model = extend_model(self.model, values)
        parameters = np.repeat(model.values(values)[None], REFERENCE_CASTS, axis=0)
        tips = model.simulate_string(self.motion, parameters, self.times).tip
        return float(np.sqrt(np.mean(np.sum((tips - self.tips) ** 2, axis=-1))))
