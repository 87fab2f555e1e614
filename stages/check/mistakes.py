"""Mistakes that make a string impossible: units, axes, the end from which arc length is
counted.

A string is as long as it is, so that neighbouring points lie as far apart as their arc
lengths say, and begins in the hand. Where it cannot be so, each common mistake is
undone in turn, then two at once; what makes it possible is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import product

import numpy as np

from stringcast.data.dataset import MAX_ARC_LENGTH_RATIO, exclude_stray_points
from stringcast.stages.check.finding import Finding, Severity
from stringcast.stages.check.gravity import median_gravity
from stringcast.stages.check.measured import GRAVITY, CheckedDataset, CheckedTrial
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

FIRST_FRAMES = 10  # at the beginning, when the clocks matter least
# of the length: so much further from the hand than its arc length is no point of this
# string
MAX_GAP_LENGTHS = 0.25
MIN_SEEN_SHARE = 0.8  # of the points must be possible: others may be outliers
NEAR_TIP_SHARE = 0.95  # of the points lie no further along than the string's end
MAX_STRETCH = 1.5  # times as long as its arc length is no piece of it
DENSE_SHARE = 0.15  # of the length: pieces so short are nearly straight
PLAUSIBLE_LENGTHS_M = (0.01, 20.0)  # [m] of strings at all
# [m] of strings that arms swing: what is taken for a mistake must leave no longer one
SWUNG_LENGTHS = 2.0
TIE_TOLERANCE = 1e-6  # of the misfit: as likely
MAX_RADIANS = 4 * np.pi  # a joint does not turn further
MAX_TURNS = 12 * np.pi  # nor does a hand
MOSTLY_SHARE = 0.9  # of the samples: others may be outliers


@dataclass(frozen=True)
class InitialView:
    """The string at the beginning of a trial.

    t (N,) [s], s (N,) [m], xy (N, 2) [m]: its points, by time and arc length. joints
    (N, J) [rad] or None; hand (N, 2) [m]: where the grasp is then, where there are no
    joints. length: of the string [m].
    """

    t: np.ndarray
    s: np.ndarray
    xy: np.ndarray
    joints: np.ndarray | None
    hand: np.ndarray
    length: float
    arm: Arm
    camera: Camera

    @property
    def grasp(self) -> np.ndarray:
        """Positions of the grasp, (N, 2) [m]."""
        return (
            self.hand
            if self.joints is None
            else self.arm.grasp_pose(self.joints)[:, :2]
        )

    @property
    def gap(self) -> float:
        """Excess of the points' distance from the hand over their arc lengths, in
        lengths of the string.
        """
        return float(
            np.quantile(
                (np.linalg.norm(self.xy - self.grasp, axis=1) - self.s) / self.length,
                MIN_SEEN_SHARE,
            )
        )

    @property
    def stretch(self) -> tuple[float, bool]:
        """Distance over arc length of neighbouring points, and whether they lie close
        together; 1 if there are none.
        """
        ds, same = np.diff(self.s), np.diff(self.t) == 0
        pieces = same & (ds > 1e-9)
        if not pieces.any():
            return 1.0, False
        ratio = np.linalg.norm(np.diff(self.xy, axis=0), axis=1)[pieces] / ds[pieces]
        return float(np.median(ratio)), bool(
            np.median(ds[pieces]) < DENSE_SHARE * self.length
        )

    @property
    def end(self) -> float:
        """The largest arc length that is seen [m], but for a few that may be wrong."""
        return float(np.quantile(self.s, NEAR_TIP_SHARE, method="lower"))

    @property
    def is_possible(self) -> bool:
        """Whether it can be a string in a hand."""
        ratio, dense = self.stretch
        return bool(
            PLAUSIBLE_LENGTHS_M[0] <= self.length <= PLAUSIBLE_LENGTHS_M[1]
            and self.end <= MAX_ARC_LENGTH_RATIO * self.length
            and ratio < MAX_STRETCH
            and (ratio > 1 / MAX_STRETCH or not dense)
            and self.gap < MAX_GAP_LENGTHS
        )

    @property
    def misfit(self) -> float:
        """Misfit of the string, 0 for one that is seen to its tip, is as long as stated
        and begins in the hand.
        """
        ratio, _ = self.stretch
        return float(
            abs(np.log(ratio))
            + abs(np.log(self.end / self.length))
            + max(self.gap, 0.0)
        )


def initial_views(
    seen: CheckedTrial, camera: Camera
) -> tuple[InitialView, InitialView]:
    """The first frames of a trial, with the hand where the clocks say, and where it
    begins if the clocks are wrong.
    """
    first = seen.points[seen.points["t"] <= seen.frame_t[:FIRST_FRAMES][-1]]
    t, s, xy = (
        first["t"].to_numpy(),
        first["s"].to_numpy(),
        first[["x", "y"]].to_numpy(),
    )
    moved = seen.pose[:, :2] if seen.joints is None else seen.joints
    now = np.stack([np.interp(t, seen.hand_t, column) for column in moved.T], axis=-1)
    begun = np.broadcast_to(moved[0], now.shape)
    if seen.joints is None:
        one, other = (
            InitialView(t, s, xy, None, hand, seen.length, seen.arm, camera)
            for hand in (now, begun)
        )
    else:
        one, other = (
            InitialView(
                t, s, xy, hand, np.empty((len(t), 0)), seen.length, seen.arm, camera
            )
            for hand in (now, begun)
        )
    return one, other


@dataclass(frozen=True)
class Mistake:
    """table, field: where it was made. said: what is so. remedy: what undoes it.
    undone: the string without it. parts, factor: of a wrong unit, which lengths are too
    large, and metres in one of it. option: for `import`.
    """

    table: str
    field: str
    statement: str
    remedy: str
    undo: Callable[[InitialView], InitialView]
    parts: tuple[str, ...] = ()
    factor: float = 1.0
    option: str = ""


SCALE: Mapping[str, Callable[[InitialView, float], InitialView]] = {
    "xy": lambda v, factor: replace(v, xy=factor * v.xy),
    "s": lambda v, factor: replace(v, s=factor * v.s),
    "length": lambda v, factor: replace(v, length=factor * v.length),
    "hand": lambda v, factor: (
        replace(v, hand=factor * v.hand) if v.joints is None else v
    ),
    "links": lambda v, factor: replace(
        v, arm=replace(v.arm, links=tuple(factor * link for link in v.arm.links))
    ),
    "base": lambda v, factor: replace(
        v, arm=replace(v.arm, base=(factor * v.arm.base[0], factor * v.arm.base[1]))
    ),
}
# where they are, what is said of them, what is to be multiplied, and what that scales
LENGTH_FIELDS = (
    ("points", "x, y", "positions are", "x and y", ("xy",)),
    ("points", "s", "arc lengths are", "s", ("s",)),
    ("dataset.yaml", "string.length", "it is", "it", ("length",)),
    ("grasp", "x, y", "positions are", "x and y", ("hand",)),
    ("dataset.yaml", "arm.links", "they are", "them", ("links",)),
    ("dataset.yaml", "arm.base", "it is", "it", ("base",)),
    ("dataset.yaml", "arm.links, arm.base", "both are", "both", ("links", "base")),
    ("points", "s, x, y", "all three are", "s, x and y", ("s", "xy")),
    ("grasp", "x, y", "here and in points, positions are", "both", ("hand", "xy")),
    ("points", "s", "s and string.length are", "both", ("s", "length")),
    (
        *("points", "s, x, y", "these, string.length and the hand's positions are"),
        *("all of them, and arm.links and arm.base,", tuple(SCALE)),
    ),
)


def unit_mistakes(unit: str, factor: float) -> tuple[Mistake, ...]:
    """Lengths in another unit than metres. factor: metres in one of it."""
    said, remedy = f"in {unit}, not in metres", f"by {factor:g}"
    return tuple(
        Mistake(
            *(table, field, f"{what} {said}", f"Multiply {those} {remedy}"),
            *(partial(scale_view, factor=factor, parts=parts), parts, factor),
        )
        for table, field, what, those, parts in LENGTH_FIELDS
    )


def scale_view(view: InitialView, factor: float, parts: Iterable[str]) -> InitialView:
    """The view with some of its parts in another unit."""
    return reduce(lambda v, part: SCALE[part](v, factor), parts, view)


MISTAKES = (
    *unit_mistakes("millimetres", 1e-3),
    *unit_mistakes("centimetres", 1e-2),
    Mistake(
        "points",
        "s",
        "arc lengths are counted from the tip, not from the grasp",
        "Replace s by string.length - s",
        lambda v: replace(v, s=v.length - v.s),
    ),
    Mistake(
        "points",
        "y",
        "y points down, not up",
        "Multiply y by -1",
        lambda v: replace(v, xy=v.xy * np.array([1, -1])),
        option="--y-down",
    ),
    Mistake(
        "points",
        "x",
        "x points to the left, not to the right",
        "Multiply x by -1",
        lambda v: replace(v, xy=v.xy * np.array([-1, 1])),
        option="--plane=-x,y",
    ),
    Mistake(
        "points",
        "x, y",
        "x and y have changed places",
        "Exchange the two columns",
        lambda v: replace(v, xy=v.xy[:, ::-1]),
        option="--plane=y,x",
    ),
    Mistake(
        "points",
        "x, y",
        "positions are in pixels, not in metres",
        "Take x = (u - camera.origin_px[0]) / camera.px_per_m and y = (camera.origin_px[1] - v) / camera.px_per_m",
        lambda v: replace(v, xy=v.camera.world(v.xy)),
    ),
    Mistake(
        "arm",
        "q1, q2, q3",
        "angles are in degrees, not in radians",
        "Multiply them by pi / 180",
        lambda v: v if v.joints is None else replace(v, joints=np.radians(v.joints)),
        option="--deg",
    ),
)


def check_mistakes(measured: CheckedDataset) -> Iterator[Finding]:
    """Strings that cannot be, and the mistake that would explain all of them best."""
    contradictory = impossible_views(measured)
    if not contradictory or unknown_arm_fields(measured):
        return
    likely = likeliest_mistakes(measured, contradictory)
    if not likely:
        yield from (
            unexplained_finding(measured, name, both[0])
            for name, both in contradictory.items()
        )
        return
    here = next(iter(contradictory.values()))[0]

    # the second best explanation, where two units fit
    instead = ""
    if len(likely) > 1 and length_factor(likely[0]) != length_factor(likely[1]):
        lengths = [
            reduce(lambda view, mistake: mistake.undo(view), made, here).length
            for made in likely[:2]
        ]
        other = likely[1][0].statement.partition(" in ")[2].partition(",")[0]
        instead = f" (a string of {lengths[0]:.3g} m; {other} would fit too, and make it {lengths[1]:.3g} m)"
    for mistake in likely[0]:
        file = mistake.table if "." in mistake.table else measured.file(mistake.table)
        said = (
            f"{mistake.statement} as it seems: {describe_contradiction(here)}{instead}"
        )
        yield Finding(
            Severity.ERROR,
            file,
            mistake.field,
            said,
            mistake.remedy,
            tuple(contradictory),
        )


def impossible_views(
    measured: CheckedDataset,
) -> dict[str, tuple[InitialView, InitialView]]:
    """Strings that cannot be, by trial. Where nobody says how long they are, as long as
    they were seen to be.
    """
    looked = {
        seen.name: initial_views(seen, measured.camera)
        for seen in measured.with_points()
    }
    if "length" not in (measured.data.metadata.get("string") or {}):
        end = max((both[0].end for both in looked.values()), default=0.0)
        if end > MAX_ARC_LENGTH_RATIO * measured.length:
            looked = {
                name: (replace(a, length=end), replace(b, length=end))
                for name, (a, b) in looked.items()
            }
    return {
        name: both
        for name, both in looked.items()
        if not any(here.is_possible for here in both)
    }


def unknown_arm_fields(measured: CheckedDataset) -> list[str]:
    """The fields of an arm (links, base) that dataset.yaml lacks although there are
    joint angles.
    """
    given = measured.data.metadata.get("arm") or {}
    by_joints = any(seen.joints is not None for seen in measured.trials)
    return [key for key in ("links", "base") if key not in given and by_joints]


def likeliest_mistakes(
    measured: CheckedDataset,
    contradictory: Mapping[str, tuple[InitialView, InitialView]],
) -> list[tuple[Mistake, ...]]:
    """The mistakes without which all of these strings are possible and fit best, the
    likeliest first: that with which they fall as things do, and millimetres before
    centimetres. Where no single one is enough, a unit and a direction that are both
    wrong; none if these are not enough either.
    """
    # with s in another unit, all would lie at one place
    units = [m for m in MISTAKES if m.parts and "s" not in m.parts]
    directions = [m for m in MISTAKES if m.option]
    for tried in (((m,) for m in MISTAKES), product(units, directions)):
        explained = {
            made: left
            for made in tried
            if (left := misfit_without(made, contradictory.values())) is not None
        }
        best = [
            made
            for made, left in explained.items()
            if left <= min(explained.values()) + TIE_TOLERANCE
        ]
        if best:
            seen = median_gravity(measured.with_points()) if len(best) > 1 else np.nan
            return sorted(
                best,
                key=lambda made: np.nan_to_num(
                    abs(np.log(abs(seen) * length_factor(made) / GRAVITY))
                ),
            )
    return []


def length_factor(made: tuple[Mistake, ...]) -> float:
    """The factor on positions of points that undoes mistakes."""
    return float(np.prod([mistake.factor for mistake in made if "xy" in mistake.parts]))


def misfit_without(
    made: tuple[Mistake, ...], contradictory: Iterable[tuple[InitialView, InitialView]]
) -> float | None:
    """The misfit of strings after mistakes are undone, summed, or None if one of them
    still cannot be.
    """
    left = []
    for both in contradictory:
        undone = (
            reduce(lambda view, mistake: mistake.undo(view), made, here)
            for here in both
        )
        left.append(
            [
                view.misfit
                for view in undone
                if view.is_possible and view.length <= SWUNG_LENGTHS
            ]
        )
        if not left[-1]:
            return None
    return sum(min(each) for each in left)


def describe_contradiction(here: InitialView) -> str:
    """The contradiction in numbers."""
    ratio, _ = here.stretch
    far = float(np.median(np.linalg.norm(here.xy - here.grasp, axis=1)))
    return (
        f"s goes up to {np.max(here.s):.4g} on a string of {here.length:.4g} m, neighbouring points are {ratio:.4g} "
        f"times as far apart as their arc lengths, and at s = {np.median(here.s):.4g} m points are {far:.4g} m from "
        "the grasp"
    )


def unexplained_finding(
    measured: CheckedDataset, name: str, here: InitialView
) -> Finding:
    """An impossible string that no common mistake explains. One that is merely too
    short is left out of a run, which is an error where no other is left.
    """
    nearest = here.s == here.s.min()
    off = np.median((here.xy - here.grasp)[nearest], axis=0)
    severity = Severity.ERROR
    if here.gap >= MAX_GAP_LENGTHS:
        said = f"the point at s = {here.s.min():.3f} m is ({off[0]:.3f}, {off[1]:.3f}) m from the grasp"
        remedy = (
            "Give points and hand in one frame of reference: see arm.base and camera.origin_px in dataset.yaml, and "
            "whether the angles count from +x, counter-clockwise"
        )
    elif replace(here, length=float(here.s.max())).is_possible:
        severity = (
            Severity.WARNING
            if exclude_stray_points(measured.data, measured.length).trials
            else Severity.ERROR
        )
        said = f"s goes up to {here.s.max():.3f} m on a string of {here.length:.3f} m, and the trial is left out"
        remedy = "Correct string.length in dataset.yaml, or s"
    else:
        said, remedy = (
            describe_contradiction(here),
            "Look at the units of s, x, y and string.length: all are metres",
        )
    return Finding(severity, measured.file("points"), "s, x, y", said, remedy, (name,))


def check_angles(measured: CheckedDataset) -> Iterator[Finding]:
    """Angles beyond what anything turns."""
    for seen in measured.trials:
        names = ("theta",) if seen.joints is None else ("q1", "q2", "q3")
        worst = float(seen.motion[list(names)].abs().quantile(MOSTLY_SHARE).max())
        if worst > (MAX_TURNS if seen.joints is None else MAX_RADIANS):
            field = ", ".join(names)
            said = f"angles are in degrees, not in radians as it seems: they go up to {worst:.4g}"
            yield Finding(
                Severity.ERROR,
                measured.hand_file,
                field,
                said,
                "Multiply them by pi / 180",
                (seen.name,),
            )
