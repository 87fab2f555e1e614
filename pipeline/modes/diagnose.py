"""Diagnose stored trials, and perform motions that distinguish candidate causes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import Diagnosis, TrialSet
from stringcast.pipeline.modes.batch import Batch
from stringcast.pipeline.modes.stored_trials import describe_rejected
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.stage_registry import stages


@dataclass(frozen=True)
class Diagnose(Batch):
    """Diagnosis that is repeated with motions that distinguish candidate causes.

    Parameters
    ----------
    motions : int
        Largest number of performed motions; with 0 the first is left for another run.
    """

    motions: int

    def moves_arm(self, config: Mapping[str, Any]) -> bool:
        return self.motions > 0

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        history, trials = self.begin_history(experiment, executor)
        stored = len(history.iterations)
        made: Diagnosis = history.make_artifact(self.stage, trials=trials)
        while made.motion is not None:
            current = history.begin_iteration(
                trial=f"performed-{len(history.iterations) + 1:02d}"
            )
            history.make_artifact("propose")
            if current.number > stored + self.motions:
                history.iterations.pop()
                break
            trials = perform_proposed_motion(history, trials)
            made = history.make_artifact(self.stage, trials=trials)
            executor.publish(history.iterations[stored:])
        # the verdict, what was left out, and what to do next
        found = json.loads(made.finding["diagnosis"].iloc[0])
        rejected, following = found["trials"]["rejected"], found["next_experiment"]
        left = f"Left out: {describe_rejected(rejected)}." if rejected else ""
        sentence = " ".join(
            filter(None, (made.sentence, left, following and following["sentence"]))
        )
        return RunResult(
            folder, tuple(history.iterations), sentence, stages()[self.stage]
        )


def perform_proposed_motion(history: History, trials: TrialSet) -> TrialSet:
    """Perform the proposed motion and add its trial to the others."""
    for name in ("execute", "extract"):
        history.make_artifact(name)
    current = history.iterations[-1]
    read = current.artifacts["points"].readings["valid"].any()
    fault = current.refusal_reason or (
        "" if read else "the string could not be read in any frame"
    )
    if fault:
        return replace(trials, rejected={**trials.rejected, current.trial_name: fault})
    seen = (*trials.observations, current.observation)
    return replace(
        trials,
        observations=seen,
        iteration_numbers=(*trials.iteration_numbers, current.number),
    )
