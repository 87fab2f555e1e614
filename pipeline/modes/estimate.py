"""Mode that estimates the string from stored trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stringcast.data import dataset
from stringcast.data.artifacts import TrialSet
from stringcast.data.estimates import Estimate, Prediction
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.cast import log_estimation
from stringcast.pipeline.modes.stepwise import require_trials
from stringcast.pipeline.modes.stored_trials import (
    STORED_ARTIFACTS,
    StoredTrialsMode,
    history_of_dataset,
    read_usable_trials,
)
from stringcast.pipeline.run.experiment import ALL_TRIALS, Experiment
from stringcast.pipeline.run.iterations import Executor, Iteration
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.run.stage_graph import StageGraph, build_graph
from stringcast.pipeline.settings.composition import Settings
from stringcast.stages.report.formatting import format_count

# stages called by name
ESTIMATION = "estimate"
PREDICTION = "predict"


@dataclass(frozen=True)
class EstimateTrials(StoredTrialsMode):
    """Estimation from one trial after another, or from all (`trials_used=all`).

    Each estimation starts at the previous estimate. The last one predicts the held-out
    trials.
    """

    def graph(self, config: Settings) -> StageGraph:
        """Return the graph of a stored trial and its estimation."""
        names = [*self.reading, ESTIMATION, PREDICTION]
        return build_graph(names, config, STORED_ARTIFACTS)

    def check(self, experiment: Experiment) -> None:
        """Refuse wrong wiring and missing trials."""
        self.graph(experiment.config)
        require_trials(experiment)

    def run_steps(
        self, experiment: Experiment, folder: Path, executor: Executor
    ) -> RunResult:
        """Estimate from the trials, then predict the held-out ones."""
        data = read_usable_trials(experiment)
        fitted = [name for name in data.trials if name not in data.held_out]
        if not fitted:
            raise DataError(
                f"trials={data.folder}",
                "dataset.yaml holds out every trial",
                "Leave some to estimate from.",
            )
        history = history_of_dataset(data, executor, self.graph(experiment.config))
        window = experiment.config["trials_used"]
        observations = []
        for number, name in enumerate(fitted, start=1):
            observations.append(self.read_trial(history, data, name, ESTIMATION))
            if window == ALL_TRIALS and number < len(fitted):
                continue
            first = 0 if window == ALL_TRIALS else max(number - window, 0)
            numbers = tuple(range(first + 1, number + 1))
            trials = TrialSet(tuple(observations[first:]), iteration_numbers=numbers)
            history.make_artifact(ESTIMATION, trials=trials)
            log_estimation(history.iterations[-1])

        for name in sorted(data.trials.keys() - set(fitted)):
            observation = self.read_trial(history, data, name, PREDICTION)
            numbers = (len(history.iterations),)
            trials = TrialSet((observation,), iteration_numbers=numbers)
            history.make_artifact(PREDICTION, trials=trials)
        sentence = estimation_outcome(history.iterations, data)
        return RunResult(folder, tuple(history.iterations), sentence)


def estimation_outcome(iterations: Sequence[Iteration], data: dataset.Dataset) -> str:
    """Describe the result of an estimation from stored trials."""
    rate, count = 0.0, len(iterations)
    prediction_sentences = []
    for iteration in iterations:
        if (estimate := iteration.find(Estimate)) is not None:
            rate = float(estimate.fit["after"].iloc[0])
        if (prediction := iteration.find(Prediction)) is not None:
            count -= 1
            score = prediction.score.iloc[0]
            prediction_sentences.append(
                f"Held out, the tip of {score['trial']} is {1e3 * score['tip']:.1f} mm "
                "off (rms)."
            )
    trials = f"{format_count(count, 'trial')} of {data.folder.name}"
    sentences = [
        f"Estimated from {trials}; the matching rate E is {rate:.3f}.",
        *prediction_sentences,
    ]
    if data.rejection_reasons:
        sentences.append(
            f"Left out: {dataset.describe_rejected(data.rejection_reasons)}."
        )
    return " ".join(sentences)
