"""Checks for mistakes that make a string impossible: units, axes, origin of arc length.

Neighbouring points lie as far apart as their arc lengths say, and the string begins
in the hand. If the data contradict this, each common mistake is undone in turn, then
two at once. The mistake that makes the string possible is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from stringcast.data.dataset import MAX_ARC_LENGTH_RATIO, exclude_stray_points
from stringcast.data.metadata import DATASET_FILE
from stringcast.stages.check.finding import Finding, error, warning
from stringcast.stages.check.gravity import median_gravity
from stringcast.stages.check.measured import GRAVITY, CheckedDataset, CheckedTrial
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera

INITIAL_FRAMES = 10  # wrong clocks matter least at the beginning
# no point is so much further from the hand than its arc length, relative to the length
MAX_GAP = 0.25
GAP_QUANTILE = 0.8  # so many points must be possible: others may be outliers
TIP_QUANTILE = 0.95  # so many points lie no further along than the tip
MAX_STRETCH = 1.5  # no piece is so many times as long as its arc length
DENSE_SPACING = 0.15  # relative to the length: shorter pieces are nearly straight
PLAUSIBLE_LENGTHS_M = (0.01, 20.0)
MAX_CORRECTED_LENGTH_M = 2.0  # no arm casts a longer string
MISFIT_TOLERANCE = 1e-6  # mistakes with equal misfit are equally likely
MAX_JOINT_ANGLE_RAD = 4 * np.pi
MAX_HAND_ANGLE_RAD = 12 * np.pi
ANGLE_QUANTILE = 0.9  # of the samples: others may be outliers


@dataclass(frozen=True)
class InitialView:
    """The string at the beginning of a trial, as the data describe it.

    Attributes
    ----------
    t, s
        Times (N,) [s] and arc lengths (N,) [m] of the points, in that order.
    xy
        Positions of the points (N, 2) [m].
    joints
        Joint angles at these times (N, J) [rad], or None.
    hand
        Positions of the grasp (N, 2) [m] if there are no joint angles.
    length
        Length of the string [m].
    arm, camera
        The arm and the camera that a run would use.
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
        """Positions of the grasp (N, 2) [m]."""
        if self.joints is None:
            return self.hand
        return self.arm.grasp_pose(self.joints)[:, :2]

    @property
    def gap(self) -> float:
        """Excess of distances from the hand over arc lengths, in lengths."""
        excess = np.linalg.norm(self.xy - self.grasp, axis=1) - self.s
        return float(np.quantile(excess / self.length, GAP_QUANTILE))

    @property
    def stretch(self) -> tuple[float, bool]:
        """Median distance over arc length of neighbours, and whether they are close.

        The ratio is 1 if there are no neighbours.
        """
        ds, is_same_frame = np.diff(self.s), np.diff(self.t) == 0
        pieces = is_same_frame & (ds > 1e-9)
        if not pieces.any():
            return 1.0, False
        distances = np.linalg.norm(np.diff(self.xy, axis=0), axis=1)[pieces]
        ratio = float(np.median(distances / ds[pieces]))
        return ratio, bool(np.median(ds[pieces]) < DENSE_SPACING * self.length)

    @property
    def end(self) -> float:
        """Largest arc length [m], apart from a few that may be wrong."""
        return float(np.quantile(self.s, TIP_QUANTILE, method="lower"))

    @property
    def is_possible(self) -> bool:
        """Whether this can be a string in a hand."""
        ratio, is_dense = self.stretch
        return bool(
            PLAUSIBLE_LENGTHS_M[0] <= self.length <= PLAUSIBLE_LENGTHS_M[1]
            and self.end <= MAX_ARC_LENGTH_RATIO * self.length
            and ratio < MAX_STRETCH
            and (ratio > 1 / MAX_STRETCH or not is_dense)
            and self.gap < MAX_GAP
        )

    @property
    def misfit(self) -> float:
        """Misfit of length, spacing and gap; 0 for a string that is seen to its tip."""
        ratio, _ = self.stretch
        end_ratio = self.end / self.length
        return float(abs(np.log(ratio)) + abs(np.log(end_ratio)) + max(self.gap, 0.0))


# the string with the hand at its own time, and with the hand where its log begins
Views = tuple[InitialView, InitialView]


def initial_views(trial: CheckedTrial, camera: Camera) -> Views:
    """Return the first frames of a trial with right clocks, and with wrong ones.

    With wrong clocks, the hand is where its log begins.
    """
    last = trial.frame_t[:INITIAL_FRAMES][-1]
    points = trial.points[trial.points["t"] <= last]
    t, s = points["t"].to_numpy(), points["s"].to_numpy()
    xy = points[["x", "y"]].to_numpy()
    log = trial.pose[:, :2] if trial.joints is None else trial.joints
    columns = [np.interp(t, trial.hand_t, column) for column in log.T]
    synchronous = np.stack(columns, axis=-1)
    first = np.broadcast_to(log[0], synchronous.shape)
    no_hand = np.empty((len(t), 0))
    views = []
    for motion in (synchronous, first):
        joints, hand = (None, motion) if trial.joints is None else (motion, no_hand)
        view = InitialView(t, s, xy, joints, hand, trial.length, trial.arm, camera)
        views.append(view)
    return views[0], views[1]


@dataclass(frozen=True)
class Mistake:
    """A common mistake in measured data.

    Attributes
    ----------
    table, field
        Where it was made.
    statement
        What is wrong.
    remedy
        How to undo it.
    undo
        Returns the view of the string without it.
    unit
        The wrong unit; empty for other mistakes.
    parts, factor
        Of a wrong unit of length: which parts of a view have it, and its size [m].
    option
        The option of `import` that undoes it.
    """

    table: str
    field: str
    statement: str
    remedy: str
    undo: Callable[[InitialView], InitialView]
    unit: str = ""
    parts: tuple[str, ...] = ()
    factor: float = 1.0
    option: str = ""


Correction = tuple[Mistake, ...]  # mistakes that are undone together

LENGTH_PARTS = ("xy", "s", "length", "hand", "links", "base")
# table, field, subject of the statement, object of the remedy, parts with a wrong unit
LENGTH_FIELDS = (
    ("points", "x, y", "positions are", "x and y", ("xy",)),
    ("points", "s", "arc lengths are", "s", ("s",)),
    (DATASET_FILE, "string.length", "it is", "it", ("length",)),
    ("grasp", "x, y", "positions are", "x and y", ("hand",)),
    (DATASET_FILE, "arm.links", "they are", "them", ("links",)),
    (DATASET_FILE, "arm.base", "it is", "it", ("base",)),
    (DATASET_FILE, "arm.links, arm.base", "both are", "both", ("links", "base")),
    ("points", "s, x, y", "all three are", "s, x and y", ("s", "xy")),
    ("grasp", "x, y", "here and in points, positions are", "both", ("hand", "xy")),
    ("points", "s", "s and string.length are", "both", ("s", "length")),
    (
        "points",
        "s, x, y",
        "these, string.length and the hand's positions are",
        "all of them, and arm.links and arm.base,",
        LENGTH_PARTS,
    ),
)


def scale_view(view: InitialView, factor: float, parts: Collection[str]) -> InitialView:
    """Multiply some lengths of a view by a factor."""
    scale = {part: factor if part in parts else 1.0 for part in LENGTH_PARTS}
    links = tuple(scale["links"] * link for link in view.arm.links)
    x, y = view.arm.base
    base = (scale["base"] * x, scale["base"] * y)
    return replace(
        view,
        xy=scale["xy"] * view.xy,
        s=scale["s"] * view.s,
        length=scale["length"] * view.length,
        hand=scale["hand"] * view.hand,
        arm=replace(view.arm, links=links, base=base),
    )


def unit_mistakes(unit: str, factor: float) -> list[Mistake]:
    """Return the mistakes of lengths in another unit, of `factor` metres."""
    mistakes = []
    for table, field, subject, target, parts in LENGTH_FIELDS:
        statement = f"{subject} in {unit}, not in metres"
        remedy = f"Multiply {target} by {factor:g}"
        undo = partial(scale_view, factor=factor, parts=parts)
        mistakes.append(
            Mistake(table, field, statement, remedy, undo, unit, parts, factor)
        )
    return mistakes


def degrees_to_radians(view: InitialView) -> InitialView:
    """Convert the joint angles of a view from degrees."""
    if view.joints is None:
        return view
    return replace(view, joints=np.radians(view.joints))


MISTAKES = (
    *unit_mistakes("millimetres", 1e-3),
    *unit_mistakes("centimetres", 1e-2),
    Mistake(
        "points",
        "s",
        "arc lengths are counted from the tip, not from the grasp",
        "Replace s by string.length - s",
        lambda view: replace(view, s=view.length - view.s),
    ),
    Mistake(
        "points",
        "y",
        "y points down, not up",
        "Multiply y by -1",
        lambda view: replace(view, xy=view.xy * np.array([1, -1])),
        option="--y-down",
    ),
    Mistake(
        "points",
        "x",
        "x points to the left, not to the right",
        "Multiply x by -1",
        lambda view: replace(view, xy=view.xy * np.array([-1, 1])),
        option="--plane=-x,y",
    ),
    Mistake(
        "points",
        "x, y",
        "x and y have changed places",
        "Exchange the two columns",
        lambda view: replace(view, xy=view.xy[:, ::-1]),
        option="--plane=y,x",
    ),
    Mistake(
        "points",
        "x, y",
        "positions are in pixels, not in metres",
        "Take x = (u - camera.origin_px[0]) / camera.px_per_m and "
        "y = (camera.origin_px[1] - v) / camera.px_per_m",
        lambda view: replace(view, xy=view.camera.world(view.xy)),
        unit="pixels",
    ),
    Mistake(
        "arm",
        "q1, q2, q3",
        "angles are in degrees, not in radians",
        "Multiply them by pi / 180",
        degrees_to_radians,
        unit="degrees",
        option="--deg",
    ),
)


def check_mistakes(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find impossible strings, and the mistake that explains all of them best."""
    contradictory = impossible_views(dataset)
    if not contradictory or unknown_arm_fields(dataset):
        return
    likely = likeliest_mistakes(dataset, contradictory)
    if not likely:
        for name, views in contradictory.items():
            yield unexplained_finding(dataset, name, views[0])
        return
    view = next(iter(contradictory.values()))[0]

    # the second best explanation, if two units fit
    alternative = ""
    if len(likely) > 1 and length_factor(likely[0]) != length_factor(likely[1]):
        best, second = (correct_view(view, correction) for correction in likely[:2])
        alternative = (
            f" (a string of {best.length:.3g} m; {likely[1][0].unit} would fit too, and"
            f" make it {second.length:.3g} m)"
        )
    for mistake in likely[0]:
        file = mistake.table if "." in mistake.table else dataset.file(mistake.table)
        statement = (
            f"{mistake.statement} as it seems: {describe_contradiction(view)}"
            f"{alternative}"
        )
        yield error(file, mistake.field, statement, mistake.remedy, *contradictory)


def impossible_views(dataset: CheckedDataset) -> dict[str, Views]:
    """Return the strings that cannot be, by trial.

    If the length is not stated, the string is as long as it was seen to be.
    """
    views_by_trial = {
        trial.name: initial_views(trial, dataset.camera)
        for trial in dataset.with_points()
    }
    if "length" not in dataset.metadata_block("string"):
        ends = [views[0].end for views in views_by_trial.values()]
        end = max(ends, default=0.0)
        if end > MAX_ARC_LENGTH_RATIO * dataset.length:
            for name, (right, wrong) in views_by_trial.items():
                views_by_trial[name] = (
                    replace(right, length=end),
                    replace(wrong, length=end),
                )
    return {
        name: views
        for name, views in views_by_trial.items()
        if not any(view.is_possible for view in views)
    }


def unknown_arm_fields(dataset: CheckedDataset) -> list[str]:
    """Return the fields of the arm that joint angles need and dataset.yaml lacks."""
    if all(trial.joints is None for trial in dataset.trials):
        return []
    block = dataset.metadata_block("arm")
    return [key for key in ("links", "base") if key not in block]


def likeliest_mistakes(
    dataset: CheckedDataset, contradictory: Mapping[str, Views]
) -> list[Correction]:
    """Return the mistakes that explain all impossible strings best.

    If no single mistake is enough, a wrong unit and a wrong direction are tried
    together. Among equals, that comes first with which the strings fall as things do.

    Parameters
    ----------
    dataset
        The data.
    contradictory
        The impossible strings by trial.

    Returns
    -------
    list of tuple of Mistake
        The likeliest first; empty if nothing explains the strings.
    """
    # with s in another unit, all points would lie at one place
    units = [m for m in MISTAKES if m.parts and "s" not in m.parts]
    directions = [m for m in MISTAKES if m.option]
    for corrections in (product(MISTAKES), product(units, directions)):
        misfits: dict[Correction, float] = {}
        for correction in corrections:
            misfit = misfit_without(correction, contradictory.values())
            if misfit is not None:
                misfits[correction] = misfit
        if not misfits:
            continue
        limit = min(misfits.values()) + MISFIT_TOLERANCE
        best = [correction for correction, misfit in misfits.items() if misfit <= limit]
        if len(best) == 1:
            return best
        gravity = abs(median_gravity(dataset.with_points()))
        gravity_errors: dict[Correction, float] = {}
        for candidate in best:
            ratio = gravity * length_factor(candidate) / GRAVITY
            gravity_errors[candidate] = float(np.nan_to_num(abs(np.log(ratio))))
        return sorted(best, key=gravity_errors.__getitem__)
    return []


def length_factor(correction: Correction) -> float:
    """Return the factor by which a correction multiplies positions of points."""
    factors = [mistake.factor for mistake in correction if "xy" in mistake.parts]
    return float(np.prod(factors))


def correct_view(view: InitialView, correction: Correction) -> InitialView:
    """Undo mistakes one after another."""
    for mistake in correction:
        view = mistake.undo(view)
    return view


def misfit_without(
    correction: Correction, contradictory: Iterable[Views]
) -> float | None:
    """Return the summed misfit of corrected strings.

    None means that one of them is still impossible.
    """
    total = 0.0
    for views in contradictory:
        corrected = [correct_view(view, correction) for view in views]
        misfits = [
            view.misfit
            for view in corrected
            if view.is_possible and view.length <= MAX_CORRECTED_LENGTH_M
        ]
        if not misfits:
            return None
        total += min(misfits)
    return total


def describe_contradiction(view: InitialView) -> str:
    """Return the contradiction in numbers."""
    ratio, _ = view.stretch
    distance = float(np.median(np.linalg.norm(view.xy - view.grasp, axis=1)))
    return (
        f"s goes up to {np.max(view.s):.4g} on a string of {view.length:.4g} m, "
        f"neighbouring points are {ratio:.4g} times as far apart as their arc lengths, "
        f"and at s = {np.median(view.s):.4g} m points are {distance:.4g} m from the "
        "grasp"
    )


def unexplained_finding(
    dataset: CheckedDataset, name: str, view: InitialView
) -> Finding:
    """Return the finding of an impossible string that no common mistake explains.

    If merely its length is too small, the trial is left out of a run, which is an error
    if no other trial remains.
    """
    report = error
    if view.gap >= MAX_GAP:
        is_nearest = view.s == view.s.min()
        x, y = np.median((view.xy - view.grasp)[is_nearest], axis=0)
        statement = (
            f"the point at s = {view.s.min():.3f} m is ({x:.3f}, {y:.3f}) m from the "
            "grasp"
        )
        remedy = (
            "Give points and hand in one frame of reference: see arm.base and "
            "camera.origin_px in dataset.yaml, and whether the angles count from +x, "
            "counter-clockwise"
        )
    elif replace(view, length=float(view.s.max())).is_possible:
        if exclude_stray_points(dataset.data, dataset.length).trials:
            report = warning
        statement = (
            f"s goes up to {view.s.max():.3f} m on a string of {view.length:.3f} m, and"
            " the trial is left out"
        )
        remedy = "Correct string.length in dataset.yaml, or s"
    else:
        statement = describe_contradiction(view)
        remedy = "Look at the units of s, x, y and string.length: all are metres"
    return report(dataset.points_file, "s, x, y", statement, remedy, name)


def check_angles(dataset: CheckedDataset) -> Iterator[Finding]:
    """Find angles beyond what joints and hands turn."""
    for trial in dataset.trials:
        if trial.joints is None:
            columns, limit = ["theta"], MAX_HAND_ANGLE_RAD
        else:
            columns, limit = ["q1", "q2", "q3"], MAX_JOINT_ANGLE_RAD
        largest = float(trial.motion[columns].abs().quantile(ANGLE_QUANTILE).max())
        if largest > limit:
            statement = (
                "angles seem to be in degrees, not in radians: they go up to "
                f"{largest:.4g}"
            )
            field, remedy = ", ".join(columns), "Multiply them by pi / 180"
            yield error(dataset.hand_file, field, statement, remedy, trial.name)
