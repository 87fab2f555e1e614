"""The check whether clocks of arm and camera differ from trial to trial.

Each trial is compared with predicted strings at several offsets of its clocks. A wrong
geometry or a hidden cause misfits at any offset.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from stringcast.stages.check.consistency.dataset import judge_dataset, measurements_of
from stringcast.stages.check.consistency.judge import (
    errors_by_offset,
    farthest_point,
    thin_tracks,
)
from stringcast.stages.check.consistency.prediction import predict
from stringcast.stages.check.consistency.record import Measurements
from stringcast.stages.check.finding import Finding, warning
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.common import MS_PER_S

OFFSETS_S = np.arange(-20, 21) * 2.5e-3  # that are tried
# Of the mean square misfit: it is up to 0.13 in 11 datasets with one clock, 0.64 if the
# clocks of the sample differ by 13 ms, and 0.3 or less if those of slow casts do
MIN_EXPLAINED_FRACTION = 0.5


def check_trial_clocks(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find clocks of arm and camera that differ from trial to trial."""
    if dataset.metadata_block("clock") or not judge_dataset(dataset).is_consistent:
        return
    offsets_s = find_trial_offsets(measurements_of(dataset))
    if not offsets_s:
        return
    first, *_, last = sorted(offsets_s, key=lambda name: offsets_s[name])
    statement = (
        "the clocks of arm and camera seem to differ from trial to trial: what must be "
        f"added to t lies between {MS_PER_S * offsets_s[first]:+.0f} ms in trial "
        f"{first} and {MS_PER_S * offsets_s[last]:+.0f} ms in trial {last}"
    )
    remedy = "If they were not synchronised, import the trials with --clock fit"
    yield warning(dataset.points_file, "t", statement, remedy, *offsets_s)


def find_trial_offsets(measured: Measurements) -> Mapping[str, float]:
    """Return the offset of each trial's clocks [s], or nothing if one suits all.

    Separate offsets must remove enough of the mean square misfit, also without the
    trial that gains most.
    """
    if not measured.recordings:
        return {}
    tip = farthest_point(measured)
    errors_of_trial = {}
    for recording in measured.recordings:
        prediction = predict(measured, recording)
        if prediction is None:
            continue
        tracks = thin_tracks(prediction, recording)
        if tracks is None:
            continue
        errors, _ = errors_by_offset(prediction, tracks, tip, OFFSETS_S)
        errors_of_trial[recording.name] = errors
    if len(errors_of_trial) < 2:
        return {}

    square = np.array([*errors_of_trial.values()]) ** 2  # (K, D, C)
    separate = square.min(axis=1)  # (K, C)
    stiffness = int(separate.sum(axis=0).argmin())
    total = square.sum(axis=0)  # (D, C)
    common = np.unravel_index(total.argmin(), total.shape)
    before = square[:, *common]
    after = separate[:, stiffness]
    others = np.arange(len(before)) != np.argmax(before - after)
    if after[others].sum() >= (1 - MIN_EXPLAINED_FRACTION) * before[others].sum():
        return {}
    best = square[:, :, stiffness].argmin(axis=1)
    return dict(zip(errors_of_trial, OFFSETS_S[best].tolist(), strict=True))
