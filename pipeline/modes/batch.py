"""One stage, asked of all trials together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import MASKS, POINTS, READINGS, Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.iterations import Executor, History
from stringcast.pipeline.modes.cast import known_stages
from stringcast.pipeline.modes.stepwise import Stepwise, needs_trials
from stringcast.pipeline.modes.stored import held_out, history_of, listed, read_points, usable
from stringcast.pipeline.registry import stages
from stringcast.pipeline.result import Result
from stringcast.pipeline.settings import UserError


@dataclass(frozen=True)
class Batch(Stepwise):
    """stage: that is asked; one that looks at `trials`. read: points are extracted where trials have frames alone.
    again: also where points are stored. first: stages that make a trial where
    none are stored; none if some must be."""

    stage: str
    read: bool
    again: bool
    first: tuple[str, ...]

    def check(self, experiment: Experiment) -> None:
        known_stages((self.stage, *self.first))
        asked = sorted(name for name, stage in stages().items() if [*stage.inputs] == ["trials"])
        if self.stage not in asked:
            raise UserError(
                f"mode.stage = {self.stage}: it does not look at trials alone. Choose {' or '.join(asked)}."
            )
        if not self.first:
            needs_trials(experiment)

    def moves(self, config: Mapping[str, Any]) -> bool:
        return config["trials"] is None and "execute" in self.first

    def work(self, experiment: Experiment, folder: Path, executor: Executor) -> Result:
        history, trials = self.begun(experiment, executor)
        made = history.make(self.stage, trials=trials)
        left = f"Left out: {listed(trials.rejected)}." if trials.rejected else ""
        sentence = " ".join(filter(None, (stages()[self.stage].summary(made).sentence, left)))
        return Result(folder, tuple(history.iterations), sentence, stages()[self.stage])

    def begun(self, experiment: Experiment, executor: Executor) -> tuple[History, TrialSet]:
        """All trials, stored, or one performed for it, and the history in which they were read. Raises DataError where
        they cannot be used."""
        if experiment.config["trials"] is None:
            history = History(executor)
            current = history.begin()
            for name in self.first:
                history.make(name)
            if current.refused:
                raise DataError(f"nothing is measured from this trial: {current.refused}.")
            trial = current.done["trial"]
            one = Observation(current.name, POINTS.empty(), READINGS.empty(), MASKS.empty(), arm=trial.arm)
            return history, TrialSet((one,), {current.name: trial.film}, numbers=(1,))
        data = usable(experiment)
        history = history_of(data, executor)
        if self.read:
            seen = [read_points(history, data, name, self.again) for name in data.trials]
        else:
            history.begin()
            seen = list(data.trials.values())
        numbers = tuple(range(1, len(history.iterations) + 1))
        return history, TrialSet(tuple(seen), data.films, data.rejected, held_out(data), numbers)
