"""Estimation alone, from stored trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stringcast.data import dataset
from stringcast.data.artifacts import Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.pipeline.experiment import ALL, Experiment
from stringcast.pipeline.iterations import Executor, Iteration
from stringcast.pipeline.modes.cast import log_fit
from stringcast.pipeline.modes.stepwise import Stepwise, needs_trials
from stringcast.pipeline.modes.stored import held_out, history_of, listed, read_points, usable
from stringcast.pipeline.result import Result


@dataclass(frozen=True)
class Estimate(Stepwise):
    """Each trial in turn, beginning with the estimate of the one before it, or all at once (`trials_used=all`).

    Trials that dataset.yaml holds out are not estimated from: what the last estimate predicts of each comes after.
    again: points are extracted also where they are stored.
    """

    again: bool

    def check(self, experiment: Experiment) -> None:
        needs_trials(experiment)

    def work(self, experiment: Experiment, folder: Path, executor: Executor) -> Result:
        data, used = usable(experiment), experiment.config["trials_used"]
        fitted = [name for name in data.trials if name not in held_out(data)]
        if not fitted:
            raise DataError(f"trials={data.folder}: dataset.yaml holds out every trial. Leave some to estimate from.")
        history = history_of(data, executor)
        seen: list[Observation] = []
        for number, name in enumerate(fitted, start=1):
            seen.append(read_points(history, data, name, self.again))
            if number == len(fitted) or used != ALL:
                first = 0 if used == ALL else max(number - used, 0)
                trials = TrialSet(tuple(seen[first:]), numbers=tuple(range(first + 1, number + 1)))
                history.make("estimate", trials=trials)
                log_fit(history.iterations[-1])
        for name in sorted(data.trials.keys() - set(fitted)):
            trial = read_points(history, data, name, self.again)
            history.make("predict", trials=TrialSet((trial,), numbers=(len(history.iterations),)))
        return Result(folder, tuple(history.iterations), estimated(history.iterations, data))


def estimated(iterations: Sequence[Iteration], data: dataset.Dataset) -> str:
    """The result of an estimation from stored trials, in a sentence or three."""
    estimates = [i.done["estimate"] for i in iterations if "estimate" in i.done]
    predicted = [i.done["prediction"].score.iloc[0] for i in iterations if "prediction" in i.done]
    count, rate = len(iterations) - len(predicted), float(estimates[-1].fit["after"].iloc[0])
    trials = f"{count} trial{'s' * (count != 1)} of {data.folder.name}"
    words = [f"Estimated from {trials}; the matching rate E is {rate:.3f}."]
    words += [f"Held out, the tip of {s['trial']} is {1e3 * s['tip']:.1f} mm off (rms)." for s in predicted]
    words += [f"Left out: {listed(data.rejected)}."] if data.rejected else []
    return " ".join(words)
