"""Overview of a dataset: a row of numbers for each usable trial."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stringcast.data.dataset import exclude_stray_points
from stringcast.stages.check.check import collect_findings
from stringcast.stages.check.clocks import is_restless, usual_interval
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.measured import CheckedDataset

# units as people say them
DISPLAY_UNITS = {
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "rad": (180 / np.pi, "deg"),
    "1": (100.0, "%"),
}
DETECTION_NOTE = (
    "Found from: the size from which on a diagnosis would find an effect in these trials, and how far it then moves "
    "the tip. Like the string: the share of what it does that the string's own parameters can imitate. Taken for: "
    "effects that are as likely at that size; larger ones are told apart. What depends on place is not asked."
)


@dataclass(frozen=True)
class OverviewRow:
    """One trial. duration: seen [s]. common: seen by the arm's clock too [s]. fps,
    hand_rate: samples [1/s]. points: in a usual frame. noise: of a coordinate [m], None
    if unknown. path: of the hand [m]. begins: at rest, moving, or what contradicts it.
    """

    trial: str
    duration: float
    common: float
    frames: int
    fps: float | None
    hand_rate: float | None
    points: float
    noise: float | None
    path: float
    begins: str


def sample_rate(t: np.ndarray) -> float | None:
    """The usual rate of samples [1/s]."""
    return 1 / usual_interval(t) if usual_interval(t) > 0 else None


def overview_rows(measured: CheckedDataset) -> list[OverviewRow]:
    """The overview's rows, one for each usable trial."""
    found, films = [], measured.data.films
    for seen in measured.trials:
        filmed = films[seen.name].t if seen.name in films else None
        # where no points were measured
        t = seen.frame_t if len(seen.frame_t) or filmed is None else filmed
        common = min(t[-1], seen.hand_t[-1]) - max(t[0], seen.hand_t[0])
        path = float(np.linalg.norm(np.diff(seen.pose[:, :2], axis=0), axis=1).sum())
        begins = "moving" if seen.starts_moving else "at rest"
        if len(seen.points) and not seen.starts_moving and is_restless(seen):
            begins = "moving?"
        each = float(len(seen.points) / max(len(seen.frame_t), 1))
        noise = None if np.isnan(seen.noise) else seen.noise
        rates = sample_rate(t), sample_rate(seen.hand_t)
        times = (float(np.ptp(t)), float(common), len(t))
        found.append(OverviewRow(seen.name, *times, *rates, each, noise, path, begins))
    return found


def detection_limit_text(told: Mapping[str, Any]) -> str:
    """The size from which on an effect would be found, in plain words. told: as of
    `check --effects`.
    """
    factor, unit = DISPLAY_UNITS.get(told["unit"], (1.0, told["unit"]))
    if told["found_from"] is None:
        return f"never: {told['most_tip_m'] * 1e3:.1f} mm at most"
    if told["absent"]:
        return f"{told['absent'] * factor:.4g} {unit} to {told['found_from'] * factor:.4g} {unit}"
    return f"{told['found_from'] * factor:.2g} {unit}"


def dataset_overview(measured: CheckedDataset) -> dict[str, Any]:
    """All that is known about the data, JSON-able; `usable` says whether an experiment
    would run on them.
    """
    found = collect_findings(measured)
    errors = sum(finding.severity is Severity.ERROR for finding in found)
    return {
        "format": 1,
        "folder": str(measured.data.folder),
        "usable": bool(exclude_stray_points(measured.data, measured.length).trials)
        and not errors,
        "string_length_m": measured.length,
        "trials": [asdict(each) for each in overview_rows(measured)],
        "rejected": dict(measured.data.rejection_reasons),
        "findings": [asdict(finding) for finding in found],
    }
