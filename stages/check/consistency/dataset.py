"""The measurements of a stored dataset, and their verdict."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pandas as pd

from stringcast.stages.check.clocks import is_restless, trials_in_seconds
from stringcast.stages.check.consistency.judge import Verdict, judge
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.measured import (
    MIN_TRACK_FRAMES,
    CheckedDataset,
    drop_spikes,
)
from stringcast.stages.string_places import (
    places_wander,
    track_places,
    tracks_at_arc_lengths,
)

MAX_PLACES = 6  # along the string; if there are more, only RELATIVE_PLACES are used
RELATIVE_PLACES = (0.25, 0.5, 1.0)  # relative to the arc length of the tip
TIP_QUANTILE = 0.95  # of arc lengths: that of the tip


@lru_cache(maxsize=4)
def judge_dataset(dataset: CheckedDataset) -> Verdict:
    """Return the verdict on a dataset; computed once."""
    return judge(measurements_of(dataset))


@lru_cache(maxsize=4)
def measurements_of(dataset: CheckedDataset) -> Measurements:
    """Return the measurements at a few places of the string.

    The length is None if it is not stated.
    """
    recordings = []
    for trial in trials_in_seconds(dataset, dataset.informative_trials()):
        tracks = tracks_along_string(trial.points)
        if tracks:
            pose = trial.pose if trial.joints is None else None
            recordings.append(
                Recording(
                    trial.name,
                    trial.hand_t,
                    trial.joints,
                    pose,
                    tracks,
                    trial.starts_moving,
                    not trial.starts_moving and is_restless(trial),
                )
            )
    is_stated = "length" in dataset.metadata_block("string")
    length = dataset.length if is_stated else None
    x, y = dataset.arm.base
    return Measurements(
        tuple(recordings),
        tuple(dataset.arm.links),
        (x, y),
        length,
        base_is_measured=dataset.geometry_is_measured,
    )


def tracks_along_string(points: pd.DataFrame) -> tuple[Track, ...]:
    """Return the tracks of a few places of the string, the innermost first.

    points: a trial's points, with columns t, s, x, y, sorted by t and s.
    """
    times, frame = np.unique(points["t"], return_inverse=True)
    s, xy = points["s"].to_numpy(), points[["x", "y"]].to_numpy()
    all_tracks = track_places(frame, s)
    tracks = [track for track in all_tracks if len(track) >= MIN_TRACK_FRAMES]
    if not tracks:
        return ()
    found = []
    if places_wander(s, all_tracks):
        end = float(np.quantile(s, TIP_QUANTILE, method="lower"))
        wanted = np.array(RELATIVE_PLACES) * end
        places = wanted[wanted >= s[tracks[0]].min()]
        places[-1:] -= 1e-9 * end
        seen = tracks_at_arc_lengths(times, frame, s, xy, places)
        for number, (place, (t, line)) in enumerate(zip(places, seen, strict=True)):
            if len(t) >= MIN_TRACK_FRAMES:
                track = drop_spikes(t, line)
                found.append(Track(f"{number}", float(place), *track))
        return tuple(found)

    arc_lengths = np.array([np.median(s[track]) for track in tracks])
    chosen = np.arange(len(tracks))
    if len(tracks) > MAX_PLACES:
        wanted = np.array(RELATIVE_PLACES) * np.quantile(arc_lengths, TIP_QUANTILE)
        chosen = np.unique(np.abs(arc_lengths[:, None] - wanted).argmin(axis=0))
    for chosen_track in chosen:
        of_place = tracks[chosen_track]
        track = drop_spikes(times[frame[of_place]], xy[of_place])
        place = float(arc_lengths[chosen_track])
        found.append(Track(f"{round(place, 4):g}", place, *track))
    return tuple(found)
