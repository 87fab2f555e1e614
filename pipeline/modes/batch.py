"""Mode that runs one stage on all trials jointly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stringcast.data.artifacts import (
    MASKS,
    POINTS,
    READINGS,
    Observation,
    Trial,
    TrialSet,
)
from stringcast.data.dataset import describe_rejected
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.stepwise import require_trials
from stringcast.pipeline.modes.stored_trials import (
    STORED_ARTIFACTS,
    StoredTrialsMode,
    history_of_dataset,
    read_usable_trials,
)
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.iterations import Executor, History
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import (
    StageGraph,
    build_graph,
    refuse_unknown_stages,
)
from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.pipeline.settings.stage_registry import stages


@dataclass(frozen=True)
class Batch(StoredTrialsMode):
    """Run of one stage on all trials jointly.

    Parameters
    ----------
    stage : str
        Stage that takes `trials`.
    first : tuple of str
        Stages that make a trial if none is stored; empty to require stored trials.
    """

    stage: str
    first: tuple[str, ...]

    def graph(self, config: Settings) -> StageGraph:
        """Return the graph of a performed or stored trial, up to the stage."""
        first = self.first if config["trials"] is None else ()
        names = [*first, *self.reading, self.stage]
        return build_graph(names, config, {} if first else STORED_ARTIFACTS)

    def check(self, experiment: Experiment) -> None:
        """Refuse missing trials, and a stage that needs other inputs."""
        refuse_unknown_stages((self.stage,))
        choices = [
            name
            for name, stage in sorted(stages().items())
            if len(stage.inputs) == 1 and stage.collected_input
        ]
        if self.stage not in choices:
            raise UserError(
                f"mode.stage = {self.stage}",
                "it does not look at trials alone",
                f"Choose {' or '.join(choices)}.",
            )
        self.graph(experiment.config)
        if not self.first:
            require_trials(experiment)

    def moves_arm(self, config: Settings) -> bool:
        """Return whether a trial is performed first."""
        return config["trials"] is None and "execute" in self.first

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        """Run the stage on all trials."""
        history, trials = self.begin_history(experiment, executor)
        collected = {stages()[self.stage].collected_input: trials}
        artifact = history.make_artifact(self.stage, **collected)
        stage = stages()[self.stage]
        sentences = [stage.summary(artifact).sentence]
        if trials.rejected:
            sentences.append(f"Left out: {describe_rejected(trials.rejected)}.")
        sentence = " ".join(filter(None, sentences))
        return RunResult(folder, tuple(history.iterations), sentence, stage)

    def begin_history(
        self, experiment: Experiment, executor: Executor
    ) -> tuple[History, TrialSet]:
        """Return the history and the trials: the stored ones, or one performed now.

        Raises DataError if they cannot be used.
        """
        graph = self.graph(experiment.config)
        if experiment.config["trials"] is None:
            return self.perform_trial(executor, graph)
        data = read_usable_trials(experiment)
        history = history_of_dataset(data, executor, graph)
        observations = tuple(data.trials.values())
        if self.reading:
            observations = tuple(
                self.read_trial(history, data, name, self.stage) for name in data.trials
            )
        else:
            history.begin_iteration()
        trials = TrialSet(
            observations,
            data.films,
            data.rejection_reasons,
            data.held_out,
            tuple(range(1, len(history.iterations) + 1)),
        )
        return history, trials

    def perform_trial(
        self, executor: Executor, graph: StageGraph
    ) -> tuple[History, TrialSet]:
        """Perform a trial without extracting points."""
        history = History(executor, graph=graph)
        iteration = history.begin_iteration()
        for name in self.first:
            history.make_artifact(name)
        if iteration.refusal_reason:
            raise DataError(
                "",
                f"nothing is measured from this trial: {iteration.refusal_reason}",
            )
        trial, name = iteration.find(Trial), iteration.trial_name
        assert trial is not None
        no_tables = POINTS.empty(), READINGS.empty(), MASKS.empty()
        observation = Observation(name, *no_tables, arm=trial.arm)
        films = {name: trial.film}
        return history, TrialSet((observation,), films, iteration_numbers=(1,))
