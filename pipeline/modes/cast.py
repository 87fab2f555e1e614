"""Mode that casts until the measured tip hits or the budget is spent (II-A)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from stringcast.data.artifacts import Motion, Points, Trial, TrialSet
from stringcast.data.estimates import Estimate
from stringcast.data.explanations import Explanation, Surprise
from stringcast.pipeline.modes.stepwise import Stepwise, refuse_trials
from stringcast.pipeline.run.experiment import ALL_TRIALS, Experiment
from stringcast.pipeline.run.iterations import LOOK_NUMBER, Executor, History, Iteration
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import StageGraph, build_graph
from stringcast.pipeline.settings.composition import Settings
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import require_allowed
from stringcast.stages.align.correction import transform_to_arm_frame
from stringcast.stages.common import describe_causes
from stringcast.stages.entry_points import DRY_RUNS
from stringcast.stages.extract.reading_report import (
    count_frames_read,
    describe_arm_misfit,
    describe_poor_reading,
)
from stringcast.stages.hit_test import HitResult, check_reach, hit_test
from stringcast.stages.spec import SameIteration, StageSpec

log = logging.getLogger(__name__)
LOOK_TRIAL = "look"  # name of the slow trial before the first cast

# the hit test as a stage
HIT_TEST = StageSpec(
    name="hit test",
    makes=HitResult,
    folder="",
    uses=("target", "obstacles"),
    run="stages.hit_test.hit_test",
    inputs={"motion": SameIteration(Motion), "points": SameIteration(Points)},
)


@dataclass(frozen=True)
class Cast(Stepwise):
    """Casts until one hits.

    Parameters
    ----------
    stages : tuple of str
        Stages of each cast, in order.
    """

    stages: tuple[str, ...]

    def look_stages(self, config: Settings) -> tuple[str, ...]:
        """Return the stages of the look: those of a cast, with another motion."""
        names = []
        for name in self.stages:
            is_plan = issubclass(stages()[name].makes, Motion)
            names.append(config["look"] if is_plan else name)
        return tuple(names)

    def graph(self, config: Settings) -> StageGraph:
        """Return the graph of a cast with hit test, and the planning of the look."""
        graph = build_graph(self.stages, config, {}, HIT_TEST)
        if config["look"] is None:
            return graph
        build_graph(self.look_stages(config), config, {})  # only checked
        return replace(graph, stages=(config["look"], *graph.stages))

    def check(self, experiment: Experiment) -> None:
        """Refuse stored trials, wrong wiring, and a target out of reach."""
        refuse_trials(experiment)
        self.graph(experiment.config)
        check_reach(experiment.target, experiment.arm, experiment.string.length)

    def moves_arm(self, config: Settings) -> bool:
        """Return whether casts are performed."""
        return config["trials"] is None and "execute" in self.stages

    def run_steps(
        self,
        experiment: Experiment,
        folder: Path,
        executor: Executor,
        before: Sequence[Iteration] = (),
    ) -> RunResult:
        """Cast until a trial hits; earlier casts are part of the budget."""
        config = experiment.config
        graph = self.graph(config)
        target = config["execute"]["_target_"]
        is_dry_run = require_allowed(target, "execute", "config.json") in DRY_RUNS
        max_casts = 1 if is_dry_run else config["max_casts"]
        history = History(executor, [*before], graph=graph)
        if config["look"] is not None and not before and not is_dry_run:
            self.look_at_string(experiment, history)

        has_hit = bool(before) and before[-1].has_hit
        while history.next_number <= max_casts and not has_hit:
            iteration = history.begin_iteration()
            self.perform_stages(self.stages, experiment, history)
            log_estimation(iteration)
            verdict = measure_hit(experiment, iteration, graph)
            iteration = replace(iteration, verdict=verdict)
            log_verdict(iteration)
            log_reading(iteration)
            history.iterations[-1] = iteration
            has_hit = iteration.has_hit
            executor.publish(history.iterations)

        iterations = tuple(history.iterations)
        if is_dry_run:
            sentence = dry_run_outcome(iterations[-1])
        else:
            sentence = cast_outcome(iterations)
        return RunResult(folder, iterations, sentence)

    def look_at_string(self, experiment: Experiment, history: History) -> None:
        """Perform the slow trial before the first cast, and estimate from it."""
        names = self.look_stages(experiment.config)
        graph_of_casts = history.graph
        history.graph = build_graph(names, experiment.config, {})
        history.first_number = LOOK_NUMBER
        look = history.begin_iteration(trial=LOOK_TRIAL)
        self.perform_stages(names, experiment, history)
        log_estimation(look)
        log_reading(look)
        history.executor.publish(history.iterations)
        history.graph = graph_of_casts

    def perform_stages(
        self, names: Sequence[str], experiment: Experiment, history: History
    ) -> None:
        """Run stages of a trial, without estimations from an invalid trial."""
        iteration = history.iterations[-1]
        for name in names:
            collected = stages()[name].collected_input
            if iteration.refusal_reason and history.lacking_input(name):
                continue  # needs an estimate that was not made
            if not collected:
                artifact = history.make_artifact(name)
                if isinstance(artifact, Motion):
                    log_prospects(iteration, artifact)
            elif not iteration.refusal_reason:
                trials = trials_for_estimation(experiment, history, name)
                history.make_artifact(name, **{collected: trials})


def log_prospects(iteration: Iteration, motion: Motion) -> None:
    """Log a warning if the motion of a cast is likely to miss."""
    if prospects := motion.outcome.iloc[0].get("prospects"):
        log.warning("%s: %s", iteration.title, prospects)


def measure_hit(
    experiment: Experiment, iteration: Iteration, graph: StageGraph
) -> HitResult:
    """Test whether the measured tip hit the target."""
    artifacts = iteration.artifacts
    motion: Motion = artifacts[graph.artifact_name(HIT_TEST.name, "motion")]
    points = artifacts.get(graph.artifact_name(HIT_TEST.name, "points"))
    if points is None:  # the wired stage was left out
        points = iteration.find(Points)
    assert points is not None
    in_arm_frame = transform_to_arm_frame(points, experiment.model)
    return hit_test(
        in_arm_frame, experiment.target, experiment.obstacles, motion.duration
    )


def log_verdict(iteration: Iteration) -> None:
    """Log how close the tip came."""
    assert iteration.verdict is not None
    distance_mm = 1e3 * iteration.verdict.distance
    message = "%s: the tip came within %.1f mm of the target"
    log.info(message, iteration.title, distance_mm)


def log_reading(iteration: Iteration) -> None:
    """Log a misfit of the arm's reported pose, and why a trial is not used."""
    points = iteration.find(Points)
    misfit = describe_arm_misfit(points.readings) if points is not None else ""
    if misfit:
        log.warning("%s: %s", iteration.title, misfit)
    if reason := iteration.refusal_reason:
        message = "%s: nothing is estimated from its trial: %s"
        log.warning(message, iteration.title, reason)


def trials_for_estimation(
    experiment: Experiment, history: History, stage: str
) -> TrialSet:
    """Return the valid trials that a stage uses: the last ones, or all."""
    trusted = [
        iteration
        for iteration in history.iterations
        if iteration.measurement_names and not iteration.refusal_reason
    ]
    window = experiment.config["trials_used"]
    used = trusted if window == ALL_TRIALS else trusted[-window:]
    return TrialSet(
        tuple(history.observe(iteration, stage) for iteration in used),
        iteration_numbers=tuple(iteration.number for iteration in used),
    )


def log_estimation(iteration: Iteration) -> None:
    """Log the results of an estimation and of the surprise test, if any."""
    estimate = iteration.find(Estimate)
    if estimate is None:
        return
    surprise = iteration.find(Surprise)
    if surprise is not None:
        log.info("surprise %d: %s", iteration.number, surprise.sentence)
    if isinstance(estimate, Explanation):
        words = "explanation %d (%s): %s"
        log.info(words, iteration.number, estimate.verdict, estimate.sentence)
    fit = estimate.fit.iloc[0]
    rates, rms_mm = fit[["before", "after"]], 1e3 * fit[["rms_before", "rms_after"]]
    message = "estimate %d: E %.3f to %.3f, rms %.1f to %.1f mm. %s"
    log.info(message, iteration.number, *rates, *rms_mm, fit["sentence"])


def cast_outcome(iterations: Sequence[Iteration]) -> str:
    """Describe the outcome of the casts in a sentence."""
    last = iterations[-1]
    explanation = last.find(Explanation)
    missing = describe_lack(explanation) if explanation is not None else ""
    if last.has_hit:
        sentence = f"The tip reached the target in cast {last.number}."
        return f"{sentence} {missing}".strip()
    tries = f"{last.number} cast{'s' if last.number > 1 else ''}"
    sentence = f"The tip did not reach the target in {tries}; the budget is spent."
    verdict = last.verdict
    if verdict is not None and verdict.entered and not verdict.touched:
        sentence += (
            f" In cast {last.number} it came into the box, but not in the wanted "
            "direction or at the wanted speed."
        )
    points = last.find(Points)
    assert points is not None
    readings = points.readings
    reasons = [describe_arm_misfit(readings), describe_poor_reading(readings)]
    return " ".join([sentence, *filter(None, [missing, *reasons])])


def describe_lack(explanation: Explanation) -> str:
    """Describe missing causes of the model; empty if none is probable."""
    if explanation.verdict not in ("cause", "candidates", "partial"):
        return ""
    causes, probability = next(iter(explanation.cause_sets.items()))
    if explanation.named_causes:
        return f"The model lacked {describe_causes(causes)}."
    words = f"{describe_causes(causes)} (probability {probability:.2f})"
    return f"The model may lack {words}."


def dry_run_outcome(iteration: Iteration) -> str:
    """Describe a dry run: delays of the link, and number of frames read."""
    trial, points = iteration.find(Trial), iteration.find(Points)
    assert trial is not None
    assert points is not None
    link = trial.link.iloc[0]

    parts = []
    if "trip_p50" in link:  # a virtual arm has no round trip
        parts.append(f"a round trip takes {_delay_ms(link, 'trip')}")
    parts.append(f"commands went out {_delay_ms(link, 'jitter', ' late')}")
    parts.append(f"{link['missed']} of {link['ticks']} were late or lost")
    parts.append(f"the string was read in {count_frames_read(points.readings)}")
    return (
        f"Dry run: {', '.join(parts)}. "
        f"Nothing is learned from it: {iteration.refusal_reason}."
    )


def _delay_ms(link: pd.Series, name: str, kind: str = "") -> str:
    median, largest = 1e3 * link[f"{name}_p50"], 1e3 * link[f"{name}_p99"]
    return f"{median:.2f} ms{kind} (99 %: {largest:.2f})"
