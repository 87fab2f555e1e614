"""Clocks: their unit, their rate, what arm and camera have in common, and who moves
first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.measured import Measured, Seen

SLOW = 0.5  # [s] between samples: no string's motion can be told from them
CERTAIN = 10  # samples from which a unit is told
LONGEST = 3600.0  # [s] of a trial: as it is simulated tick by tick, 7e5 of 5 ms
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
# of the time in which the string was seen: so little of the hand's motion says too
# little
FEW = 0.5
RATE = 0.05  # by which fps may differ from what the times say
EARLY, LATE = 0.1, 0.3  # [s] by which the string may move before and after the hand
GAP = 10.0  # times the usual distance of samples
LONG = 0.05  # [s] of a gap in the hand's motion


def times(measured: Measured, seen: Seen) -> dict[str, np.ndarray]:
    """Times [s] by file."""
    return {measured.hand_file: seen.hand_t, measured.file("points"): seen.frame_t}


def usual(t: np.ndarray) -> float:
    """Distance of samples [s]; 0 where there are none."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def factor_of(t: np.ndarray) -> float:
    """The factor by which times (F,) are too large for seconds: 1 where they may be
    seconds, infinity where by no unit's.
    """
    return next(
        f for f in (1.0, *UNITS, np.inf) if usual(t) / f < SLOW or len(t) < CERTAIN
    )


def unit(measured: Measured) -> Iterator[Finding]:
    """Times that are no seconds."""
    for seen in measured.with_points():
        for file, t in times(measured, seen).items():
            factor = factor_of(t)
            if factor in UNITS:
                said = f"times are in {UNITS[factor]}, not in seconds as it seems: samples are {usual(t):.4g} apart"
                yield Finding(
                    Severity.ERROR,
                    file,
                    "t",
                    said,
                    f"Multiply t by {1 / factor:g}",
                    (seen.name,),
                )


def in_seconds(measured: Measured, trials: Iterable[Seen]) -> Iterator[Seen]:
    """The trials of whose clocks more can be said than that they count in another unit."""
    for seen in trials:
        if not any(factor_of(t) in UNITS for t in times(measured, seen).values()):
            yield seen


def lasting(measured: Measured) -> Iterator[Finding]:
    """Trials of hours: a time that is wrong, as a rule."""
    for seen in measured.trials:
        for file, t in times(measured, seen).items():
            if len(t) and not np.ptp(t) <= LONGEST and factor_of(t) not in UNITS:
                said = f"times span {np.ptp(t):.4g} s; at most {LONGEST:.0f} s are simulated"
                remedy = (
                    "Correct the time that is wrong, or cut the trial into shorter ones"
                )
                yield Finding(Severity.ERROR, file, "t", said, remedy, (seen.name,))


def begun(measured: Measured) -> Iterator[Finding]:
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


def rate(measured: Measured) -> Iterator[Finding]:
    """Frames that come at another rate than the camera is said to have."""
    stated = (measured.data.metadata.get("camera") or {}).get("fps")
    for seen in measured.telling():
        step = usual(seen.frame_t)
        if stated is None or not 0 < step < SLOW:
            continue
        fps = 1 / step
        # every second frame may have been kept
        whole = max(round(float(stated) / fps), 1)
        if abs(fps * whole / float(stated) - 1) > RATE:
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


def overlap(measured: Measured) -> Iterator[Finding]:
    """A hand whose motion is known for little of the time."""
    for seen in in_seconds(measured, measured.with_points()):
        first, last = (
            max(seen.hand_t[0], seen.frame_t[0]),
            min(seen.hand_t[-1], seen.frame_t[-1]),
        )
        span = float(np.ptp(seen.frame_t))
        if last - first < FEW * span:
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


def together(measured: Measured) -> Iterator[Finding]:
    """A string at rest that moves long before or after the hand."""
    for seen in in_seconds(measured, measured.telling()):
        hand, string = seen.hand_onset, seen.string_onset
        if seen.moving or hand is None or string is None or restless(seen):
            continue
        if hand - string > EARLY or string - hand > LATE:
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


def rest(measured: Measured) -> Iterator[Finding]:
    """A string that moves without the hand, though it is said to be at rest."""
    for seen in measured.telling():
        if not seen.moving and restless(seen):
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


def scarce(measured: Measured) -> Iterator[Finding]:
    """A string that was seen so seldom that its motion cannot be told."""
    for seen in in_seconds(measured, measured.with_points()):
        if seen.scarce:
            said = (
                f"each place was seen {seen.rate:.2g} times a second; a string of {seen.length:.3g} m swings so fast "
                f"that {seen.least_rate:.2g} are the least"
            )
            remedy = "Film faster, or track more frames: how the string moves between them is unknown"
            yield Finding(
                Severity.ERROR, measured.file("points"), "t", said, remedy, (seen.name,)
            )


def restless(seen: Seen) -> bool:
    """Whether the string moves though the hand never does, or as soon as it is seen and
    long before the hand.
    """
    hand, string = seen.hand_onset, seen.string_onset
    if string is None or hand is None:
        return string is not None
    return string - float(seen.frame_t[0]) < EARLY < hand - string


def gaps(measured: Measured) -> Iterator[Finding]:
    """Long times without a sample: of the hand while it moves, or of the string."""
    for seen in measured.with_points():
        for file, t in times(measured, seen).items():
            steps = np.diff(t)
            widest = float(steps.max(initial=0.0))
            if widest < max(GAP * usual(t), LONG):
                continue
            said = f"{int((steps > GAP * usual(t)).sum())} gap(s), the longest {widest:.3f} s"
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
