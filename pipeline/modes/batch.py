"""Run one stage on all trials together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import MASKS, POINTS, READINGS, Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.cast import refuse_unknown_stages
from stringcast.pipeline.modes.stepwise import Stepwise, require_trials
from stringcast.pipeline.modes.stored_trials import (
    describe_rejected,
    held_out_trials,
    history_of_dataset,
    read_points,
    read_usable_trials,
)
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.stage_registry import stages


@dataclass(frozen=True)
class Batch(Stepwise):
    """A stage on all trials.

    Parameters
    ----------
    stage : str
        Stage that takes `trials`.
    read : bool
        Extract points of trials that have only frames.
    again : bool
        Extract points again where they are stored.
    first : tuple of str
        Stages that make a trial if none are stored; empty if stored ones are required.
    """

    stage: str
    read: bool
    again: bool
    first: tuple[str, ...]

    def check(self, experiment: Experiment) -> None:
        refuse_unknown_stages((self.stage, *self.first))
        asked = sorted(
            name for name, stage in stages().items() if [*stage.inputs] == ["trials"]
        )
        if self.stage not in asked:
            raise UserError(
                f"mode.stage = {self.stage}: it does not look at trials alone. Choose {' or '.join(asked)}."
            )
        if not self.first:
            require_trials(experiment)

    def moves_arm(self, config: Mapping[str, Any]) -> bool:
        return config["trials"] is None and "execute" in self.first

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        history, trials = self.begin_history(experiment, executor)
        made = history.make_artifact(self.stage, trials=trials)
        left = (
            f"Left out: {describe_rejected(trials.rejected)}."
            if trials.rejected
            else ""
        )
        sentence = " ".join(
            filter(None, (stages()[self.stage].summary(made).sentence, left))
        )
        return RunResult(
            folder, tuple(history.iterations), sentence, stages()[self.stage]
        )

    def begin_history(
        self, experiment: Experiment, executor: Executor
    ) -> tuple[History, TrialSet]:
        """Return the history and the trials: the stored ones, or one performed now.

        Raises
        ------
        DataError
            If they cannot be used.
        """
        if experiment.config["trials"] is None:
            history = History(executor)
            current = history.begin_iteration()
            for name in self.first:
                history.make_artifact(name)
            if current.refusal_reason:
                raise DataError(
                    f"nothing is measured from this trial: {current.refusal_reason}."
                )
            trial = current.artifacts["trial"]
            one = Observation(
                current.trial_name,
                POINTS.empty(),
                READINGS.empty(),
                MASKS.empty(),
                arm=trial.arm,
            )
            return history, TrialSet(
                (one,), {current.trial_name: trial.film}, iteration_numbers=(1,)
            )
        data = read_usable_trials(experiment)
        history = history_of_dataset(data, executor)
        if self.read:
            seen = [
                read_points(history, data, name, self.again) for name in data.trials
            ]
        else:
            history.begin_iteration()
            seen = list(data.trials.values())
        numbers = tuple(range(1, len(history.iterations) + 1))
        return history, TrialSet(
            tuple(seen),
            data.films,
            data.rejection_reasons,
            held_out_trials(data),
            numbers,
        )
