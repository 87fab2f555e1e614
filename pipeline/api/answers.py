"""Answers from trials: a diagnosis, or an estimate alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from matplotlib.figure import Figure

from stringcast.data import dataset
from stringcast.data.artifacts import Diagnosis, Estimate
from stringcast.data.store import write_text
from stringcast.known import KnownString, experiment_for_call
from stringcast.measured import Trials
from stringcast.pipeline.cli.console import progress_bars
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.modes.stored_trials import held_out_trials
from stringcast.pipeline.run.experiment import Experiment
from stringcast.pipeline.run.report import page_provenance
from stringcast.pipeline.run.stopping import stop_stage_on_interrupt
from stringcast.stages.check.check import refuse_errors
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.common import Progress
from stringcast.stages.report.pages.diagnosis import diagnosis_page
from stringcast.stages.report.records import StageRecord

MM_PER_M = 1e3  # [mm] in a metre


@dataclass(frozen=True)
class DiagnosisResult:
    """The discrepancy between simulation and trials, and its causes.

    made: every table of the diagnosis. experiment: model, data and settings of the
    diagnosis.
    """

    artifact: Diagnosis
    experiment: Experiment

    @property
    def document(self) -> dict[str, Any]:
        """diagnosis.json, see data/README.md."""
        return dict(json.loads(self.artifact.finding["diagnosis"].iloc[0]))

    @property
    def verdict(self) -> str:
        """none, effect, ambiguous, unknown or insufficient."""
        return self.artifact.verdict

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.artifact.sentence

    @property
    def causes(self) -> pd.DataFrame:
        """A row for each parameter of each cause: probability, value, low, high, unit."""
        return self.artifact.causes

    @property
    def budget(self) -> pd.DataFrame:
        """How far each source moves the tip, root mean square [m]: the causes,
        numerical error, noise, what is unexplained; as `budget` in diagnosis.json.
        Empty where there is no verdict on causes.
        """
        return pd.DataFrame(self.document.get("budget", []))

    @property
    def gain(self) -> pd.DataFrame:
        """Base and extended model on each trial, fitted without it: residuals [m] and
        log-likelihood.
        """
        return self.artifact.held_out

    @property
    def extended_model(self) -> KnownString:
        """The model with the causes, for all that comes after."""
        return KnownString(
            yaml.safe_load(self.artifact.finding["extended"].iloc[0]) or {}
        )

    def plot(self) -> Figure:
        """The residual of base and extended model on each trial left out, and what
        noise alone leaves.
        """
        table = self.gain
        figure = Figure(figsize=(5.4, 1.4 + 0.3 * len(table)), layout="constrained")
        axes = figure.subplots()
        for model in ("base", "extended"):
            axes.plot(
                table[f"rms_{model}"] * MM_PER_M,
                table["trial"],
                "o",
                label=f"{model} model",
            )
        axes.plot(
            table["noise_floor"] * MM_PER_M,
            table["trial"],
            "|",
            markersize=14,
            color="0.2",
            label="noise floor",
        )
        axes.set(
            xlabel="residual on the trial left out, RMS / mm",
            xlim=(0, None),
            title=self.verdict,
        )
        axes.legend()
        return figure

    def report(self, page: str | Path) -> Path:
        """Write the page with all the evidence; one file that needs no network. Returns
        its path.
        """
        here = self.experiment
        facts = StageRecord(
            "diagnosis",
            self.sentence,
            self.artifact,
            here.model,
            here.config,
            page_provenance(here),
        )
        write_text(Path(page), diagnosis_page(facts))
        return Path(page)

    def __repr__(self) -> str:
        """The verdict in words."""
        return f"Diagnosed({self.verdict}: {self.sentence})"

    def _repr_html_(self) -> str:
        shown = self.causes[
            ["effect", "probability", "parameter", "value", "low", "high", "unit"]
        ]
        return f"<p><b>{escape(self.verdict)}</b>. {escape(self.sentence)}</p>{shown.to_html(index=False)}"


@dataclass(frozen=True)
class EstimateResult:
    """String parameters found from trials. made: every table of the estimation.
    experiment: that it was asked of.
    """

    artifact: Estimate
    experiment: Experiment

    @property
    def sentence(self) -> str:
        """The parameters that the trials determine and those that they do not, in
        words.
        """
        return str(self.artifact.fit["sentence"].iloc[0])

    @property
    def parameters(self) -> pd.DataFrame:
        """A row for each parameter: value, 95 % interval, range, unit, meaning."""
        return self.artifact.parameters

    @property
    def rms(self) -> float:
        """Root mean square distance between measured and simulated points, in sample
        [m].
        """
        return float(self.artifact.fit["rms_after"].iloc[0])

    @property
    def string(self) -> KnownString:
        """The string with these parameters, for all that comes after."""
        settings = {
            "string": self.experiment.config["string"],
            "effects": list(self.experiment.config["effects"]),
        }
        return KnownString(settings | {"parameter_values": self.artifact.values()})

    def __repr__(self) -> str:
        """How near, and what is determined."""
        return f"Estimated({len(self.parameters)} parameters, {self.rms * MM_PER_M:.2f} mm rms. {self.sentence})"

    def _repr_html_(self) -> str:
        shown = self.parameters[["name", "value", "low", "high", "unit", "meaning"]]
        return f"<p>{self.rms * MM_PER_M:.2f} mm rms. {escape(self.sentence)}</p>{shown.to_html(index=False)}"


def diagnose(trials: Trials, *settings: str) -> DiagnosisResult:
    """Diagnose the discrepancy between the simulation and these trials. Takes a minute
    or more, and shows its progress. Ctrl-C, or the stop button of a notebook, ends it
    with what it knows: `verdict` is `insufficient` then.
    """
    here, data = prepare_trials(trials, ("+experiment=diagnose", *settings))
    with progress_bar("diagnose") as progress, stop_stage_on_interrupt():
        given = (
            here.model,
            list(data.trials.values()),
            data.rejection_reasons,
            held_out_trials(data),
            here.obstacles,
        )
        return DiagnosisResult(
            here.stages["diagnose"](*given, seed=here.seed, progress=progress), here
        )


def estimate(
    trials: Trials, *settings: str, string: KnownString | None = None
) -> EstimateResult:
    """String parameters of least squares from all trials together but those held out,
    with 95 % intervals.

    settings: words as on the command line, such as "effects=[tip_mass]" or
    "estimate=random_search". string: what is known before. Raises StringcastError for
    data that cannot be used.
    """
    by = (
        ()
        if any(word.startswith("estimate=") for word in settings)
        else ("estimate=least_squares",)
    )
    here, data = prepare_trials(
        trials, ("+experiment=estimate", *by, *settings), string
    )
    with progress_bar("estimate") as progress:
        seen = [
            trial
            for name, trial in data.trials.items()
            if name not in held_out_trials(data)
        ]
        given = (here.model, seen, None)
        made = here.stages["estimate"](
            *given, seed=here.seed, manipulation=1, progress=progress
        )
        return EstimateResult(made, here)


def prepare_trials(
    trials: Trials, settings: tuple[str, ...], string: KnownString | None = None
) -> tuple[Experiment, dataset.Dataset]:
    """All that is asked with, and the trials that fit this string."""
    here = experiment_for_call(settings, string, trials=str(trials.folder))
    refuse_errors(
        CheckedDataset(trials.data, here.arm, here.camera, here.string.length)
    )
    return here, dataset.exclude_stray_points(trials.data, here.string.length)


@contextmanager
def progress_bar(name: str) -> Iterator[Progress]:
    """A bar, as a run shows it."""
    with progress_bars(Terminal(stderr=True)) as bar, bar(name) as progress:
        yield progress
