"""Overview of a dataset: a row of numbers for each usable trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.dataset import exclude_stray_points
from stringcast.stages.check.check import collect_findings
from stringcast.stages.check.clocks import is_restless, usual_interval
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.model.polyline import step_lengths

# factor and name of displayed units
DISPLAY_UNITS = {
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "rad": (180 / np.pi, "deg"),
    "1": (100.0, "%"),
}
DETECTION_NOTE = (
    "Found from: the size from which on a diagnosis would find an effect in these "
    "trials, and how far it then moves the tip. Like the string: the share of its "
    "motion that the string's own parameters can imitate. Taken for: effects that are "
    "as likely at that size; larger ones can be distinguished. Effects that depend on "
    "a place are not listed."
)


def sample_rate(t: np.ndarray) -> float | None:
    """Return the usual rate of samples [1/s]; None if there are fewer than two."""
    interval = usual_interval(t)
    return 1 / interval if interval > 0 else None


def overview_rows(dataset: CheckedDataset) -> list[dict[str, Any]]:
    """Return a row for each usable trial.

    Returns
    -------
    list of dict
        trial; duration seen by the camera [s], and common: by the arm's clock as well
        [s]; frames; fps and hand_rate: samples of string and hand [1/s]; points: mean
        number in a frame; noise of a coordinate [m], None if unknown; path: length of
        the hand's path [m]; begins: "at rest", "moving", or "moving?" if the string
        seems to move although it is stated to be at rest.
    """
    rows, films = [], dataset.data.films
    for trial in dataset.trials:
        # without points, use the frames of the film
        t = trial.frame_t
        if not len(t) and trial.name in films:
            t = films[trial.name].t
        common = min(t[-1], trial.hand_t[-1]) - max(t[0], trial.hand_t[0])
        steps = step_lengths(trial.pose[:, :2])
        begins = "moving" if trial.starts_moving else "at rest"
        if len(trial.points) and not trial.starts_moving and is_restless(trial):
            begins = "moving?"
        row = {
            "trial": trial.name,
            "duration": float(np.ptp(t)),
            "common": float(common),
            "frames": len(t),
            "fps": sample_rate(t),
            "hand_rate": sample_rate(trial.hand_t),
            "points": float(len(trial.points) / max(len(trial.frame_t), 1)),
            "noise": None if np.isnan(trial.noise) else trial.noise,
            "path": float(steps.sum()),
            "begins": begins,
        }
        rows.append(row)
    return rows


def detection_limit_text(limit: Mapping[str, Any]) -> str:
    """Describe the size, with its unit, from which an effect would be found.

    limit: an entry of `effects` in the output of `check --effects`.
    """
    factor, unit = DISPLAY_UNITS.get(limit["unit"], (1.0, limit["unit"]))
    if limit["found_from"] is None:
        return f"never: {limit['most_tip_m'] * 1e3:.1f} mm at most"
    size = limit["found_from"] * factor
    if limit["absent"]:
        return f"{limit['absent'] * factor:.4g} {unit} to {size:.4g} {unit}"
    return f"{size:.2g} {unit}"


def trial_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Tabulate the rows of `overview_rows` as texts for people."""
    table = []
    for row in rows:
        texts = {
            "trial": row["trial"],
            "camera [s]": f"{row['duration']:.2f}",
            "with arm [s]": f"{row['common']:.2f}",
            "frames": str(row["frames"]),
            "frames per s": format_known(row["fps"], 1, 0),
            "arm rows per s": format_known(row["hand_rate"], 1, 0),
            "points": format_known(row["points"], 1, 0),
            "noise [mm]": format_known(row["noise"], 1e3, 2),
            "hand path [m]": f"{row['path']:.2f}",
            "begins": row["begins"],
        }
        table.append(texts)
    return pd.DataFrame(table)


def effect_table(limits: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Tabulate `effects` of the output of `check --effects` as texts for people."""
    table = []
    for limit in limits:
        texts = {
            "effect": f"{limit['effect']}.{limit['parameter']}",
            "meaning": limit["meaning"],
            "detectable from": detection_limit_text(limit),
            "tip [mm]": format_known(limit["tip_m"], 1e3, 1),
            "imitated by string": f"{limit['imitated']:.0%}",
            "mistaken for": ", ".join(limit["alike"]) or "-",
        }
        table.append(texts)
    return pd.DataFrame(table)


def format_known(value: float | None, factor: float, digits: int) -> str:
    """Return a number times a factor, or a dash if it is unknown."""
    return "-" if value is None else f"{value * factor:.{digits}f}"


def dataset_overview(dataset: CheckedDataset) -> dict[str, Any]:
    """Return trials, rejected trials and findings of the data for JSON.

    `usable` states whether an experiment would run on the data.
    """
    findings = collect_findings(dataset)
    has_errors = any(finding.severity is Severity.ERROR for finding in findings)
    usable_trials = exclude_stray_points(dataset.data, dataset.length).trials
    return {
        "format": 1,
        "folder": str(dataset.data.folder),
        "usable": bool(usable_trials) and not has_errors,
        "string_length_m": dataset.length,
        "trials": overview_rows(dataset),
        "rejected": dict(dataset.data.rejection_reasons),
        "findings": [asdict(finding) for finding in findings],
    }
