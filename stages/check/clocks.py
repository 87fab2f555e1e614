"""Clocks: their unit, their rate, what arm and camera have in common, and who moves
first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import CheckedDataset, CheckedTrial

SLOW_RATE = 0.5  # [s] between samples: no string's motion can be told from them
CERTAIN_FACTOR = 10  # samples from which a unit is told
LONGEST_TRIAL_S = 3600.0  # [s] of a trial: as it is simulated tick by tick, 7e5 of 5 ms
TIME_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
# of the time in which the string was seen: so little of the hand's motion says too
# little
MIN_COVERED_SHARE = 0.5
RATE_TOLERANCE = 0.05  # by which fps may differ from what the times say
EARLY_S, LATE_S = 0.1, 0.3  # [s] by which the string may move before and after the hand
GAP_INTERVALS = 10.0  # times the usual distance of samples
MIN_GAP_S = 0.05  # [s] of a gap in the hand's motion


def times_by_file(
    measured: CheckedDataset, seen: CheckedTrial
) -> dict[str, np.ndarray]:
    """Times [s] by file."""
    return {measured.hand_file: seen.hand_t, measured.file("points"): seen.frame_t}


def usual_interval(t: np.ndarray) -> float:
    """Distance of samples [s]; 0 where there are none."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def time_unit_factor(t: np.ndarray) -> float:
    """The factor by which times (F,) are too large for seconds: 1 where they may be
    seconds, infinity where by no unit's.
    """
    return next(
        f
        for f in (1.0, *TIME_UNITS, np.inf)
        if usual_interval(t) / f < SLOW_RATE or len(t) < CERTAIN_FACTOR
    )


def check_time_unit(measured: CheckedDataset) -> Iterator[Finding]:
    """Times that are no seconds."""
    for seen in measured.with_points():
        for file, t in times_by_file(measured, seen).items():
            factor = time_unit_factor(t)
            if factor in TIME_UNITS:
                said = f"times are in {TIME_UNITS[factor]}, not in seconds as it seems: samples are {usual_interval(t):.4g} apart"
                yield Finding(
                    Severity.ERROR,
                    file,
                    "t",
                    said,
                    f"Multiply t by {1 / factor:g}",
                    (seen.name,),
                )


def trials_in_seconds(
    measured: CheckedDataset, trials: Iterable[CheckedTrial]
) -> Iterator[CheckedTrial]:
    """The trials of whose clocks more can be said than that they count in another unit."""
    for seen in trials:
        if not any(
            time_unit_factor(t) in TIME_UNITS
            for t in times_by_file(measured, seen).values()
        ):
            yield seen


def check_duration(measured: CheckedDataset) -> Iterator[Finding]:
    """Trials of hours: a time that is wrong, as a rule."""
    for seen in measured.trials:
        for file, t in times_by_file(measured, seen).items():
            if (
                len(t)
                and not np.ptp(t) <= LONGEST_TRIAL_S
                and time_unit_factor(t) not in TIME_UNITS
            ):
                said = f"times span {np.ptp(t):.4g} s; at most {LONGEST_TRIAL_S:.0f} s are simulated"
                remedy = (
                    "Correct the time that is wrong, or cut the trial into shorter ones"
                )
                yield Finding(Severity.ERROR, file, "t", said, remedy, (seen.name,))


def check_clock_start(measured: CheckedDataset) -> Iterator[Finding]:
    """Clocks that began long before their trial."""
    for name, begin in measured.data.clock_starts.items():
        said = f"times begin at {begin:.15g} s; in what is made of them they are counted from there"
        yield Finding(
            Severity.NOTE,
            measured.hand_file,
            "t",
            said,
            "Nothing needs to be done",
            (name,),
        )


def check_frame_rate(measured: CheckedDataset) -> Iterator[Finding]:
    """Frames that come at another rate than the camera is said to have."""
    stated = (measured.data.metadata.get("camera") or {}).get("fps")
    for seen in measured.informative_trials():
        step = usual_interval(seen.frame_t)
        if stated is None or not 0 < step < SLOW_RATE:
            continue
        fps = 1 / step
        # every second frame may have been kept
        whole = max(round(float(stated) / fps), 1)
        if abs(fps * whole / float(stated) - 1) > RATE_TOLERANCE:
            said = f"frames come {fps:.4g} times a second, camera.fps in dataset.yaml is {float(stated):g}"
            remedy = "Correct the one that is wrong; of slow motion count the frames as filmed"
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "t",
                said,
                remedy,
                (seen.name,),
            )


def check_overlap(measured: CheckedDataset) -> Iterator[Finding]:
    """A hand whose motion is known for little of the time."""
    for seen in trials_in_seconds(measured, measured.with_points()):
        first, last = (
            max(seen.hand_t[0], seen.frame_t[0]),
            min(seen.hand_t[-1], seen.frame_t[-1]),
        )
        span = float(np.ptp(seen.frame_t))
        if last - first < MIN_COVERED_SHARE * span:
            said = f"arm and camera have {last - first:.2f} s in common of {span:.2f} s in which the string was seen"
            remedy = "See that both clocks begin together, or leave out points of other times"
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "t",
                said,
                remedy,
                (seen.name,),
            )


def check_onsets(measured: CheckedDataset) -> Iterator[Finding]:
    """A string at rest that moves long before or after the hand."""
    for seen in trials_in_seconds(measured, measured.informative_trials()):
        hand, string = seen.hand_onset, seen.string_onset
        if seen.starts_moving or hand is None or string is None or is_restless(seen):
            continue
        if hand - string > EARLY_S or string - hand > LATE_S:
            later = string - hand
            said = f"the string begins to move {abs(later):.2f} s {'after' if later > 0 else 'before'} the hand"
            remedy = f"If the clocks differ by that, {'subtract it from' if later > 0 else 'add it to'} t of points"
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "t",
                said,
                remedy,
                (seen.name,),
            )


def check_rest(measured: CheckedDataset) -> Iterator[Finding]:
    """A string that moves without the hand, though it is said to be at rest."""
    for seen in measured.informative_trials():
        if not seen.starts_moving and is_restless(seen):
            said = "the string moves before the hand does, or the hand never moves"
            remedy = (
                "If it was let go or already swung, write 'initial: moving' in dataset.yaml (for one trial, under "
                "trials); else begin the trial earlier"
            )
            yield Finding(
                Severity.WARNING,
                measured.file("points"),
                "t",
                said,
                remedy,
                (seen.name,),
            )


def check_sampling(measured: CheckedDataset) -> Iterator[Finding]:
    """A string that was seen so seldom that its motion cannot be told."""
    for seen in trials_in_seconds(measured, measured.with_points()):
        if seen.is_undersampled:
            said = (
                f"each place was seen {seen.rate:.2g} times a second; a string of {seen.length:.3g} m swings so fast "
                f"that {seen.least_rate:.2g} are the least"
            )
            remedy = "Film faster, or track more frames: how the string moves between them is unknown"
            yield Finding(
                Severity.ERROR, measured.file("points"), "t", said, remedy, (seen.name,)
            )


def is_restless(seen: CheckedTrial) -> bool:
    """Whether the string moves though the hand never does, or as soon as it is seen and
    long before the hand.
    """
    hand, string = seen.hand_onset, seen.string_onset
    if string is None or hand is None:
        return string is not None
    return string - float(seen.frame_t[0]) < EARLY_S < hand - string


def check_gaps(measured: CheckedDataset) -> Iterator[Finding]:
    """Long times without a sample: of the hand while it moves, or of the string."""
    for seen in measured.with_points():
        for file, t in times_by_file(measured, seen).items():
            steps = np.diff(t)
            widest = float(steps.max(initial=0.0))
            if widest < max(GAP_INTERVALS * usual_interval(t), MIN_GAP_S):
                continue
            said = f"{int((steps > GAP_INTERVALS * usual_interval(t)).sum())} gap(s), the longest {widest:.3f} s"
            gap = int(np.argmax(steps))
            # of the hand in it
            way = float(np.linalg.norm(np.diff(seen.pose[gap : gap + 2, :2], axis=0)))
            moved = file == measured.hand_file and way > 0.01 * seen.length
            severity = Severity.WARNING if moved else Severity.NOTE
            remedy = (
                "The hand's motion in them is a guess: leave the trial out"
                if moved
                else "Nothing needs to be done"
            )
            yield Finding(severity, file, "t", said, remedy, (seen.name,))
