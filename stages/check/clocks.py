"""Checks of times: unit, rate, overlap of both clocks, and onsets of motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from stringcast.stages.check.finding import Finding, error, note, warning
from stringcast.stages.check.measured import CheckedDataset, CheckedTrial
from stringcast.stages.inference.basis import LOW_FREQUENCY_HZ, highest_frequency

MAX_INTERVAL_S = 0.5  # between samples that show the motion of a string
MIN_SAMPLES_FOR_UNIT = 10
MAX_TRIAL_S = 3600.0  # a trial is simulated in ticks of 5 ms: 7e5 of them
TIME_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
# of the time in which the string was seen: share with known motion of the hand
MIN_COVERED_SHARE = 0.5
# relative difference of fps from the rate of the times
RATE_TOLERANCE = 0.01
MIN_RATE_DIFFERENCE = 0.002  # smaller ones shift a trial of a second by half a frame
MIN_RATE_SIGMAS = 3.0
# allowed lead and lag of the string's onset relative to the hand's
MAX_LEAD_S, MAX_LAG_S = 0.1, 0.3
MAX_CLOCK_FRAMES = 4.0  # uncertainty of the clock offset, above which a note is given
MIN_FRAME_S = 1e-6
SAMPLING_REMEDY = (
    "Film faster, or track more frames: how the string moves between them is unknown"
)
GAP_INTERVALS = 10.0  # least length of a gap, in usual intervals
MIN_GAP_S = 0.05
MIN_GAP_DISTANCE = 0.01  # of the hand within a gap, relative to the string's length


def times_by_file(
    dataset: CheckedDataset, trial: CheckedTrial
) -> dict[str, np.ndarray]:
    """Return times (F,) [s] of hand and string by file."""
    return {dataset.hand_file: trial.hand_t, dataset.points_file: trial.frame_t}


def usual_interval(t: np.ndarray) -> float:
    """Return the median distance of samples [s]; 0 if there are fewer than two."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def time_unit_factor(t: np.ndarray) -> float:
    """Return the factor by which times (F,) are too large for seconds.

    It is 1 if they may be seconds, and infinity if no known unit explains them.
    """
    if len(t) < MIN_SAMPLES_FOR_UNIT:
        return 1.0
    for factor in (1.0, *TIME_UNITS):
        if usual_interval(t) / factor < MAX_INTERVAL_S:
            return factor
    return np.inf


def check_time_unit(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find times that are not in seconds."""
    for trial in dataset.with_points():
        for file, t in times_by_file(dataset, trial).items():
            factor = time_unit_factor(t)
            if factor in TIME_UNITS:
                statement = (
                    f"times seem to be in {TIME_UNITS[factor]}, not in seconds: "
                    f"samples are {usual_interval(t):.4g} apart"
                )
                remedy = f"Multiply t by {1 / factor:g}"
                yield error(file, "t", statement, remedy, trial.name)


def trials_in_seconds(
    dataset: CheckedDataset, trials: Iterable[CheckedTrial]
) -> Iterator[CheckedTrial]:
    """Yield the trials whose times are not in another unit."""
    for trial in trials:
        times = times_by_file(dataset, trial).values()
        if TIME_UNITS.keys().isdisjoint(map(time_unit_factor, times)):
            yield trial


def check_duration(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find trials of hours, usually because of one wrong time."""
    for trial in dataset.trials:
        for file, t in times_by_file(dataset, trial).items():
            if not len(t) or time_unit_factor(t) in TIME_UNITS:
                continue
            if not np.ptp(t) <= MAX_TRIAL_S:  # NaN is found, too
                statement = (
                    f"times span {np.ptp(t):.4g} s; at most {MAX_TRIAL_S:.0f} s are "
                    "simulated"
                )
                remedy = "Correct the time that is wrong, or split the trial"
                yield error(file, "t", statement, remedy, trial.name)


def check_bandwidth(dataset: CheckedDataset) -> Iterator[Finding]:
    """Report trials so long that a diagnosis does not follow fast misfit."""
    for trial in dataset.trials:
        duration = float(np.ptp(trial.frame_t)) if len(trial.frame_t) else 0.0
        if duration == 0:
            continue
        frequency = highest_frequency(trial.frame_t)
        if frequency <= LOW_FREQUENCY_HZ:
            statement = (
                f"it is {duration:.1f} s long: a diagnosis follows misfit there up to "
                f"{frequency:.0f} Hz"
            )
            remedy = "Split it into trials of 2 s to see faster misfit"
            yield note(dataset.points_file, "t", statement, remedy, trial.name)


def check_clock_start(dataset: CheckedDataset) -> Iterator[Finding]:
    """Report clocks that began long before their trial."""
    for name, start in dataset.data.clock_starts.items():
        statement = f"times begin at {start:.15g} s; results count time from there"
        remedy = "Nothing needs to be done"
        yield note(dataset.hand_file, "t", statement, remedy, name)


def check_frame_rate(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find frame rates that differ from the stated one of the camera."""
    fps = dataset.metadata_block("camera").get("fps")
    if fps is None:
        return
    fps = float(fps)
    for trial in dataset.informative_trials():
        t = trial.frame_t
        usual = usual_interval(t)
        if not 0 < usual < MAX_INTERVAL_S or len(t) < MIN_SAMPLES_FOR_UNIT:
            continue
        # frames may be missing, and possibly only every second or third one was kept;
        # the median of rounded times is too inaccurate to count frames in a long gap
        gaps = np.diff(t, prepend=t[0])
        single = gaps[np.rint(gaps / usual) == 1]
        mean = single.mean() if len(single) else usual
        steps = np.rint(gaps / mean)
        line, covariance = np.polyfit(steps.cumsum(), t, 1, cov=True)
        interval, sigma = float(line[0]), float(np.sqrt(covariance[0, 0]))

        frames_per_sample = max(round(fps * interval), 1)
        difference = abs(frames_per_sample / (interval * fps) - 1)
        uncertainty = MIN_RATE_SIGMAS * sigma / interval
        if difference <= max(MIN_RATE_DIFFERENCE, uncertainty):
            continue
        statement = (
            f"there are {1 / interval:.4g} frames per second, but camera.fps in "
            f"dataset.yaml is {fps:g}"
        )
        remedy = (
            "Correct the one that is wrong; in slow motion count the frames as filmed"
        )
        report = warning if difference > RATE_TOLERANCE else note
        yield report(dataset.points_file, "t", statement, remedy, trial.name)


def check_overlap(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find trials with little overlap between the times of hand and points."""
    for trial in trials_in_seconds(dataset, dataset.with_points()):
        first = max(trial.hand_t[0], trial.frame_t[0])
        last = min(trial.hand_t[-1], trial.frame_t[-1])
        duration = float(np.ptp(trial.frame_t))
        if last - first < MIN_COVERED_SHARE * duration:
            statement = (
                f"arm and camera have {last - first:.2f} s in common of "
                f"{duration:.2f} s in which the string was seen"
            )
            remedy = (
                "See that both clocks begin together, or leave out points of other "
                "times"
            )
            yield warning(dataset.points_file, "t", statement, remedy, trial.name)


def check_onsets(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find strings at rest that begin to move long before or after the hand."""
    for trial in trials_in_seconds(dataset, dataset.informative_trials()):
        hand, string = trial.hand_onset, trial.string_onset
        if hand is None or string is None:
            continue
        if trial.starts_moving or is_restless(trial):
            continue
        if hand - string > MAX_LEAD_S:
            order, remedy = "before", "add it to"
        elif string - hand > MAX_LAG_S:
            order, remedy = "after", "subtract it from"
        else:
            continue
        statement = (
            f"the string begins to move {abs(string - hand):.2f} s {order} the hand"
        )
        remedy = f"If the clocks differ by that, {remedy} t of points"
        yield warning(dataset.points_file, "t", statement, remedy, trial.name)


def check_clock_interval(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find clocks whose stated offset is uncertain by more than a few frames."""
    clock = dataset.data.metadata.get("clock")
    intervals = [usual_interval(trial.frame_t) for trial in dataset.with_points()]
    if not clock or not intervals:
        return
    width = clock["high"] - clock["low"]
    frames = width / max(min(intervals), MIN_FRAME_S)
    if frames > MAX_CLOCK_FRAMES:
        statement = (
            f"the clocks of arm and camera are known to {width * 1e3:.0f} ms, or "
            f"{frames:.0f} frames; a diagnosis takes them as unknown within that"
        )
        remedy = (
            "To know it better, record a sharp tap of the hand, a synchronising pulse, "
            "or an LED of the robot that the camera sees"
        )
        yield note("dataset.yaml", "clock", statement, remedy)


def check_rest(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find strings that move before the hand although they are stated to be at rest."""
    for trial in dataset.informative_trials():
        if not trial.starts_moving and is_restless(trial):
            statement = "the string moves before the hand does, or the hand never moves"
            remedy = (
                "If it was released or already swung, write 'initial: moving' in "
                "dataset.yaml (for one trial, under trials); else begin the trial "
                "earlier"
            )
            yield warning(dataset.points_file, "t", statement, remedy, trial.name)


def check_sampling(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find strings with too few frames to show their motion."""
    for trial in trials_in_seconds(dataset, dataset.with_points()):
        if trial.is_undersampled:
            statement = describe_sampling(trial)
            yield error(
                dataset.points_file, "t", statement, SAMPLING_REMEDY, trial.name
            )


def describe_sampling(trial: CheckedTrial) -> str:
    """Describe the rate at which a string was seen, and the required rate."""
    return (
        f"each place was seen {trial.rate:.2g} times a second; a string of "
        f"{trial.length:.3g} m needs at least {trial.least_rate:.2g}"
    )


def is_restless(trial: CheckedTrial) -> bool:
    """Return whether the string moves although the hand rests.

    Either the hand never moves, or the string moves from its first frame on and long
    before the hand.
    """
    hand, string = trial.hand_onset, trial.string_onset
    if string is None or hand is None:
        return string is not None
    return string - float(trial.frame_t[0]) < MAX_LEAD_S < hand - string


def check_gaps(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find long times without a sample of the hand or of the string."""
    for trial in dataset.with_points():
        for file, t in times_by_file(dataset, trial).items():
            intervals = np.diff(t)
            longest = float(intervals.max(initial=0.0))
            limit = GAP_INTERVALS * usual_interval(t)
            if longest < max(limit, MIN_GAP_S):
                continue
            gaps = int((intervals > limit).sum())
            statement = f"{gaps} gap(s), the longest {longest:.3f} s"

            # only motion of the hand within the gap matters
            start = int(np.argmax(intervals))
            ends = trial.pose[start : start + 2, :2]
            distance = float(np.linalg.norm(np.diff(ends, axis=0)))
            is_hand = file == dataset.hand_file
            if is_hand and distance > MIN_GAP_DISTANCE * trial.length:
                remedy = "The hand's motion in them is unknown: leave the trial out"
                yield warning(file, "t", statement, remedy, trial.name)
            else:
                remedy = "Nothing needs to be done"
                yield note(file, "t", statement, remedy, trial.name)
