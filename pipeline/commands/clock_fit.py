"""The offset of two clocks, for the commands `import` and `check`.

It is a separate module, as it takes seconds to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stringcast.pipeline.cli.console import progress_bar
from stringcast.pipeline.commands.dataset_import import ImportedDataset
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.model_settings import build_string
from stringcast.stages.check.finding import Finding, error
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.clock.offset import (
    ClockOffset,
    describe_drift,
    estimate_clock_offset,
    find_wrong_clock,
    wrong_clock_error,
)
from stringcast.stages.model.model import Model

SEED = 0  # of starting points of fits


def estimate_offset(checked: CheckedDataset) -> ClockOffset:
    """Estimate the offset of the clocks of a dataset, with a bar on the terminal.

    Raises DataError if nothing moves in a trial, or if the clocks run at rates that no
    diagnosis represents.
    """
    model = plain_model(checked)
    observations = [trial.observation for trial in checked.with_points()]
    rng = np.random.default_rng(SEED)
    with progress_bar("clocks") as progress:
        clock = estimate_clock_offset(model, observations, rng, progress)
    if clock.wrong_rate is not None:
        raise wrong_clock_error(clock, f"{checked.points_file} t")
    return clock


def plain_model(checked: CheckedDataset) -> Model:
    """Return the base model of a diagnosis, with arm and camera of a dataset."""
    settings = compose_settings(["+experiment=diagnose"])
    block = {**settings["string"], "length": checked.length}
    return Model(build_string(block, "conf/string"), checked.arm, checked.camera)


def wrong_clock_findings(checked: CheckedDataset) -> list[Finding]:
    """Return an error if the motion shows an offset of the clocks.

    A bar on the terminal shows the progress.
    """
    observations = [trial.observation for trial in checked.informative_trials()]
    rng = np.random.default_rng(SEED)
    with progress_bar("clocks") as progress:
        clock = find_wrong_clock(plain_model(checked), observations, rng, progress)
    if clock is None:
        return []
    wrong = wrong_clock_error(clock, checked.points_file)
    return [error(checked.points_file, "t", wrong.fault, wrong.remedy)]


def apply_offset(imported: ImportedDataset, clock: ClockOffset) -> ImportedDataset:
    """Return the dataset with the offset applied, and its interval as metadata."""
    values = {name: interval.value for name, interval in clock.by_trial.items()}
    rough = imported.added_times
    # trials without motion get the offset of the others
    usual = float(np.median([*values.values()]))
    shifts = dict.fromkeys(rough, usual) | values
    added = {name: rough[name] + shifts[name] for name in rough}
    shift = imported.points["trial"].map(shifts).fillna(0.0)
    points = imported.points.assign(t=imported.points["t"] + shift)
    block = clock_block(clock, added)
    return replace(
        imported,
        points=points,
        added_times=added,
        metadata={**imported.metadata, "clock": block},
        notes=[*imported.notes, *describe_offset(clock, added)],
    )


def clock_block(clock: ClockOffset, added: Mapping[str, float]) -> dict[str, Any]:
    """Return the block `clock` of dataset.yaml after the offset was added."""
    low = min(interval.low - interval.value for interval in clock.by_trial.values())
    high = max(interval.high - interval.value for interval in clock.by_trial.values())
    rounded = {name: round(value, 6) for name, value in added.items()}
    common = next(iter(rounded.values()))
    return {
        "low": round(low, 6),
        "high": round(high, 6),
        "added": common if clock.is_common else rounded,
    }


def describe_offset(clock: ClockOffset, added: Mapping[str, float]) -> list[str]:
    """Describe the offset added to the camera's times, and its interval."""
    notes = []
    names = list(clock.by_trial)
    described = names[:1] if clock.is_common else names
    for name in described:
        interval = clock.by_trial[name]
        low = added[name] + interval.low - interval.value
        high = added[name] + interval.high - interval.value
        where = "all trials" if clock.is_common else f"trial {name}"
        notes.append(
            f"{added[name]:+.4f} s are added to the camera's clock in {where}, by the "
            f"motion of hand and string; 95 % interval {low:+.4f} to {high:+.4f} s"
        )
    if not clock.is_common:
        notes.append("the trials do not have the same offset: each has its own")
    if clock.drift is not None:
        drift = describe_drift(clock.drift)
        notes.append(f"{drift}: is its frame rate right? Give it with --fps")
    return notes
