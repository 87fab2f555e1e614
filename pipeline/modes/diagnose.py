"""Mode that diagnoses trials and performs motions that distinguish causes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from stringcast.data.artifacts import TrialSet
from stringcast.data.diagnoses import Diagnosis
from stringcast.pipeline.modes.batch import Batch
from stringcast.pipeline.modes.stored_trials import (
    STORED_ARTIFACTS,
    refuse_unlike_clocks,
)
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import StageGraph, build_graph
from stringcast.pipeline.settings.composition import Settings
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.spec import StageSummary

PERFORMANCE = ("propose", "execute")  # stages that perform a proposed motion


@dataclass(frozen=True)
class Diagnose(Batch):
    """Diagnosis, repeated after motions that distinguish candidate causes.

    Parameters
    ----------
    motions : int
        Largest number of performed motions; 0: only propose one.
    """

    motions: int

    def graph(self, config: Settings) -> StageGraph:
        """Return the graph of a trial that performs the last proposed motion."""
        names = [*PERFORMANCE, *self.reading, self.stage]
        return build_graph(names, config, STORED_ARTIFACTS)

    def moves_arm(self, config: Settings) -> bool:
        """Return whether motions may be performed."""
        return self.motions > 0

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        """Diagnose, and repeat after each performed motion."""
        history, trials = self.begin_history(experiment, executor)
        source = experiment.config["trials"]
        if source is not None:
            refuse_unlike_clocks(experiment, Path(source), trials.observations)
        stored = len(history.iterations)
        collected = stages()[self.stage].collected_input
        diagnosis: Diagnosis = history.make_artifact(self.stage, **{collected: trials})
        while diagnosis.motion is not None:
            trial_name = f"performed-{len(history.iterations) + 1:02d}"
            iteration = history.begin_iteration(trial=trial_name)
            history.make_artifact(PERFORMANCE[0])
            if iteration.number > stored + self.motions:
                history.iterations.pop()
                break
            trials = self.perform_proposed_motion(history, trials)
            diagnosis = history.make_artifact(self.stage, **{collected: trials})
            executor.publish(history.iterations[stored:])
        stage = stages()[self.stage]
        summary = stage.summary(diagnosis)
        sentence = diagnosis_outcome(diagnosis, summary)
        return RunResult(folder, tuple(history.iterations), sentence, stage)

    def perform_proposed_motion(self, history: History, trials: TrialSet) -> TrialSet:
        """Perform the proposed motion and add its trial to the others."""
        for name in (*PERFORMANCE[1:], *self.reading):
            history.make_artifact(name)
        iteration = history.iterations[-1]
        fault = iteration.refusal_reason
        observation = history.observe(iteration, self.stage)
        if fault:
            rejected = {**trials.rejected, iteration.trial_name: fault}
            return replace(trials, rejected=rejected)
        return replace(
            trials,
            observations=(*trials.observations, observation),
            iteration_numbers=(*trials.iteration_numbers, iteration.number),
        )


def diagnosis_outcome(diagnosis: Diagnosis, summary: StageSummary) -> str:
    """Describe the verdict, the gain, and the next experiment."""
    sentences = [summary.sentence]
    if next_experiment := diagnosis.document["next_experiment"]:
        sentences.append(next_experiment["sentence"])
    return " ".join(filter(None, sentences))
