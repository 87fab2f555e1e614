"""Diagnose trials, or estimate parameters from them."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from stringcast.data.dataset import Dataset
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.estimates import Estimate
from stringcast.data.store import write_text
from stringcast.figures import diagnosis_figure, parameter_figure
from stringcast.known import KnownString, experiment_for_call
from stringcast.measured import Trials
from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.modes.stored_trials import check_trials, refuse_unlike_clocks
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.report import page_provenance
from stringcast.pipeline.run.stopping import stop_stage_on_interrupt
from stringcast.stages.common import MM_PER_M
from stringcast.stages.report.pages.diagnosis import diagnosis_page
from stringcast.stages.report.records import StageRecord
from stringcast.stages.workers import use_workers

# fits into 80 columns
CAUSE_COLUMNS = [
    *("effect", "probability", "parameter", "value", "low", "high", "unit"),
]


@dataclass(frozen=True)
class DiagnosisResult:
    """The misfit between simulation and trials, and its causes.

    Parameters
    ----------
    artifact : Diagnosis
        All tables of the diagnosis.
    experiment : Experiment
        Model, data and settings of the diagnosis.
    """

    artifact: Diagnosis
    experiment: Experiment

    @property
    def document(self) -> dict[str, Any]:
        """The content of diagnosis.json, see data/README.md."""
        return self.artifact.document

    @property
    def verdict(self) -> str:
        """The verdict: none, effect, ambiguous, partial, unknown or insufficient."""
        return self.artifact.verdict

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.artifact.sentence

    @property
    def causes(self) -> pd.DataFrame:
        """A row for each parameter of each cause, with value, 95 % interval and unit.

        `high` is infinite if only the lower end is known. `document` holds more.
        """
        table = self.artifact.causes
        high = table["high"].where(~table["at_least"].astype(bool), np.inf)
        return table.assign(high=high)[CAUSE_COLUMNS]

    @property
    def budget(self) -> pd.DataFrame:
        """The misfit at the tip by source, rms [m]; empty without a verdict on causes.

        Sources are the causes, numerical error, noise, and the unexplained rest.
        """
        return pd.DataFrame(self.document.get("budget", []))

    @property
    def gain(self) -> pd.DataFrame:
        """Residuals [m] and log-likelihood of both models on left-out trials."""
        return self.artifact.held_out

    @property
    def extended_model(self) -> KnownString:
        """The model that includes the causes."""
        return KnownString(
            yaml.safe_load(self.artifact.finding["extended"].iloc[0]) or {}
        )

    def plot(self) -> Figure:
        """Draw the frame with the largest misfit of the base model, and all residuals.

        Returns
        -------
        Figure
            Shown by a notebook; `savefig` writes it.

        Raises
        ------
        StringcastError
            If too few trials could be used.
        """
        return diagnosis_figure(self.artifact.residuals, self.gain)

    def report(self, page: str | Path) -> Path:
        """Write the page with all the evidence, one file that needs no network.

        Parameters
        ----------
        page : str or Path
            File to write.

        Returns
        -------
        Path
            The file that was written.
        """
        record = StageRecord(
            "diagnosis",
            self.sentence,
            self.artifact,
            self.experiment.model,
            self.experiment.config,
            page_provenance(self.experiment),
        )
        write_text(Path(page), diagnosis_page(record))
        return Path(page)

    def __repr__(self) -> str:
        """Return the verdict in words."""
        return f"DiagnosisResult({self.verdict}: {self.sentence})"

    def __str__(self) -> str:
        """Return the verdict in words and the table of causes."""
        text = f"{self.verdict}: {self.sentence}"
        if self.causes.empty:
            return text
        return f"{text}\n\n{self.causes.to_string(index=False)}"

    def _repr_html_(self) -> str:
        headline = f"<p><b>{escape(self.verdict)}</b>. {escape(self.sentence)}</p>"
        return headline + str(self.causes.to_html(index=False))


@dataclass(frozen=True)
class EstimateResult:
    """String parameters estimated from trials.

    Parameters
    ----------
    artifact : Estimate
        All tables of the estimation.
    experiment : Experiment
        Model, data and settings of the estimation.
    """

    artifact: Estimate
    experiment: Experiment

    @property
    def sentence(self) -> str:
        """The parameters that the trials determine, and the others."""
        return str(self.artifact.fit["sentence"].iloc[0])

    @property
    def parameters(self) -> pd.DataFrame:
        """A row for each parameter: value, 95 % interval, range, unit, meaning."""
        return self.artifact.parameters

    @property
    def rms(self) -> float:
        """The in-sample rms distance of measured and simulated points [m]."""
        return float(self.artifact.fit["rms_after"].iloc[0])

    @property
    def string(self) -> KnownString:
        """The string with these parameters."""
        settings = {
            "string": self.experiment.config["string"],
            "effects": list(self.experiment.config["effects"]),
        }
        return KnownString(settings | {"parameter_values": self.artifact.values()})

    def plot(self) -> Figure:
        """Draw each parameter with its interval, within the range of its search.

        Returns
        -------
        Figure
            Shown by a notebook; `savefig` writes it.
        """
        return parameter_figure(self.parameters)

    def __repr__(self) -> str:
        """Return the residual and the determined parameters."""
        count, rms = len(self.parameters), f"{self.rms * MM_PER_M:.2f} mm rms"
        return f"EstimateResult({count} parameters, {rms}. {self.sentence})"

    def _repr_html_(self) -> str:
        columns = ["name", "value", "low", "high", "unit", "meaning"]
        headline = f"{self.rms * MM_PER_M:.2f} mm rms. {escape(self.sentence)}"
        table = self.parameters[columns].to_html(index=False)
        return f"<p>{headline}</p>{table}"


def diagnose(trials: Trials, *settings: str) -> DiagnosisResult:
    """Find the causes of the misfit between the simulation and trials.

    This takes a minute or more and shows its progress. Ctrl-C, or the stop button of a
    notebook, ends it early with the verdict `insufficient`.

    Parameters
    ----------
    trials : Trials
        Measured trials, at least two.
    *settings : str
        Settings as on the command line, such as "string.points=15".

    Returns
    -------
    DiagnosisResult
        Verdict, causes, gain and extended model.

    Raises
    ------
    StringcastError
        If the data or a setting cannot be used.
    """
    experiment, data = prepare_trials(trials, ("+experiment=diagnose", *settings))
    observations = list(data.trials.values())
    refuse_unlike_clocks(experiment, trials.folder, observations)
    workers = use_workers(experiment.config["workers"])
    with (
        progress_bar("diagnose") as progress,
        stop_stage_on_interrupt(),
        threadpool_limits(1, "blas"),  # as in commands
        workers,
    ):
        artifact = experiment.stages["diagnose"](
            experiment.model,
            observations,
            data.rejection_reasons,
            data.held_out,
            experiment.obstacles,
            seed=experiment.seed,
            progress=progress,
        )
    return DiagnosisResult(artifact, experiment)


def estimate(
    trials: Trials, *settings: str, string: KnownString | None = None
) -> EstimateResult:
    """Estimate string parameters from all trials that are not held out.

    The default method is least squares; it gives 95 % intervals.

    Parameters
    ----------
    trials : Trials
        Measured trials.
    *settings : str
        Settings as on the command line, such as "effects=[tip_mass]" or
        "estimate=random_search".
    string : KnownString, optional
        Prior knowledge of the string.

    Returns
    -------
    EstimateResult
        Parameters with intervals, and the string with them.

    Raises
    ------
    StringcastError
        If the data or a setting cannot be used.
    """
    words = ("+experiment=estimate", "estimate=least_squares", *settings)
    if any(word.startswith("estimate=") for word in settings):
        words = ("+experiment=estimate", *settings)
    experiment, data = prepare_trials(trials, words, string)
    used = [trial for name, trial in data.trials.items() if name not in data.held_out]
    with progress_bar("estimate") as progress:
        artifact = experiment.stages["estimate"](
            experiment.model,
            used,
            None,
            seed=experiment.seed,
            cast_number=1,
            progress=progress,
        )
    return EstimateResult(artifact, experiment)


def prepare_trials(
    trials: Trials, settings: tuple[str, ...], string: KnownString | None = None
) -> tuple[Experiment, Dataset]:
    """Compose the experiment, and drop points beyond its string.

    Raises
    ------
    StringcastError
        If the data are clearly wrong.
    """
    experiment = experiment_for_call(settings, string, trials=str(trials.folder))
    return experiment, check_trials(experiment, trials.data)
