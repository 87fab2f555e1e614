"""Estimate the string from stored trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stringcast.data import dataset
from stringcast.data.artifacts import Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.cast import log_fit
from stringcast.pipeline.modes.stepwise import Stepwise, require_trials
from stringcast.pipeline.modes.stored_trials import (
    describe_rejected,
    held_out_trials,
    history_of_dataset,
    read_points,
    read_usable_trials,
)
from stringcast.pipeline.run.experiment import ALL_TRIALS, Experiment
from stringcast.pipeline.run.iterations import Executor, Iteration
from stringcast.pipeline.run.result import RunResult


@dataclass(frozen=True)
class Estimate(Stepwise):
    """Estimation from one trial after another, or from all (`trials_used=all`).

    Each estimation starts at the estimate before. The last estimate predicts the trials
    that dataset.yaml holds out.

    Parameters
    ----------
    again : bool
        Extract points again where they are stored.
    """

    again: bool

    def check(self, experiment: Experiment) -> None:
        require_trials(experiment)

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        data, used = read_usable_trials(experiment), experiment.config["trials_used"]
        fitted = [name for name in data.trials if name not in held_out_trials(data)]
        if not fitted:
            raise DataError(
                f"trials={data.folder}: dataset.yaml holds out every trial. Leave some to estimate from."
            )
        history = history_of_dataset(data, executor)
        seen: list[Observation] = []
        for number, name in enumerate(fitted, start=1):
            seen.append(read_points(history, data, name, self.again))
            if number == len(fitted) or used != ALL_TRIALS:
                first = 0 if used == ALL_TRIALS else max(number - used, 0)
                trials = TrialSet(
                    tuple(seen[first:]),
                    iteration_numbers=tuple(range(first + 1, number + 1)),
                )
                history.make_artifact("estimate", trials=trials)
                log_fit(history.iterations[-1])
        for name in sorted(data.trials.keys() - set(fitted)):
            trial = read_points(history, data, name, self.again)
            history.make_artifact(
                "predict",
                trials=TrialSet((trial,), iteration_numbers=(len(history.iterations),)),
            )
        return RunResult(
            folder,
            tuple(history.iterations),
            estimation_outcome(history.iterations, data),
        )


def estimation_outcome(iterations: Sequence[Iteration], data: dataset.Dataset) -> str:
    """Describe the result of an estimation from stored trials."""
    estimates = [
        i.artifacts["estimate"] for i in iterations if "estimate" in i.artifacts
    ]
    predicted = [
        i.artifacts["prediction"].score.iloc[0]
        for i in iterations
        if "prediction" in i.artifacts
    ]
    count, rate = (
        len(iterations) - len(predicted),
        float(estimates[-1].fit["after"].iloc[0]),
    )
    trials = f"{count} trial{'s' * (count != 1)} of {data.folder.name}"
    words = [f"Estimated from {trials}; the matching rate E is {rate:.3f}."]
    words += [
        f"Held out, the tip of {s['trial']} is {1e3 * s['tip']:.1f} mm off (rms)."
        for s in predicted
    ]
    words += (
        [f"Left out: {describe_rejected(data.rejection_reasons)}."]
        if data.rejection_reasons
        else []
    )
    return " ".join(words)
