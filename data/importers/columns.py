"""The meaning of a column from its name.

Examples: `joint1_deg`, `Time (Seconds)`, `tip_x_mm` and `actual_TCP_pose_0`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi


def _alike(words: str, value: float) -> dict[str, float]:
    return dict.fromkeys(words.split(), value)


def _words(text: str) -> set[str]:
    return set(text.split())


TIME_UNITS = {
    **_alike("s sec secs second seconds", 1.0),
    **_alike("ms msec msecs millis millisec millisecond milliseconds", 1e-3),
    **_alike("us usec usecs micros microsec microsecond microseconds", 1e-6),
    **_alike("ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds", 1e-9),
}
LENGTH_UNITS = {
    **_alike("m meter meters metre metres", 1.0),
    **_alike("cm centimeter centimeters centimetres", 1e-2),
    **_alike("mm millimeter millimeters millimetres", 1e-3),
    "um": 1e-6,
    "dm": 0.1,
    **_alike("in inch inches", 0.0254),
}
ANGLE_UNITS = {
    **_alike("rad radian radians", 1.0),
    **_alike("deg degree degrees °", pi / 180),
    "mrad": 1e-3,
}
PIXEL_WORDS = {"px", "pixel", "pixels"}
UNITS = {*TIME_UNITS, *LENGTH_UNITS, *ANGLE_UNITS, *PIXEL_WORDS}
TIME_WORDS = _words(
    "t ts time times timestamp tstamp stamp datetime elapsed epoch unixtime zeit"
)
FRAME_WORDS = _words("frame frames")
INDEX_WORDS = _words("index idx number num no nr id")
TRIAL_WORDS = _words("trial episode run take cast shot recording")
# a column of one of these names the point that its row holds
LABEL_WORDS = _words("marker point keypoint bodypart label particle")
JOINT_WORDS = _words(
    "joint jnt q j axis a motor servo angle ang theta th phi achse gelenk"
)
# joints of serial arms named by body part, base first, as in ROS drivers
NAMED_JOINTS = (
    ("shoulder pan", "1"),
    ("shoulder lift", "2"),
    ("shoulder", "1"),
    ("elbow flex", "3"),
    ("elbow", "3"),
    ("wrist 1", "4"),
    ("wrist 2", "5"),
    ("wrist 3", "6"),
    ("wrist flex", "4"),
    ("wrist roll", "5"),
    ("wrist", "4"),
)
HAND_WORDS = _words("tcp hand grasp gripper ee eef effector tool wrist flange clamp")
DIRECTION_WORDS = _words("theta yaw angle phi heading rz rotation orientation")
QUATERNION_AXES = ("qx", "qy", "qz", "qw")
QUATERNION_WORDS = _words("orientation quaternion quat")  # as in hand_orientation_x
ARC_LENGTH_WORDS = {"s", "arc", "arclength"}
QUALITY_WORDS = {
    **dict.fromkeys(("likelihood", "confidence", "score"), "likelihood"),
    **dict.fromkeys(("valid", "visible", "tracked"), "valid"),
    **dict.fromkeys(("sigma", "std", "uncertainty"), "sigma"),
}
RATE_WORDS = "vel velocity velocities speed acc acceleration jerk qd qdd rate"
LOAD_WORDS = "torque effort force current voltage temperature moment power"
COMMAND_WORDS = (
    "cmd command commanded target goal desired setpoint reference ref action"
)
NON_POSITION_WORDS = _words(
    f"{RATE_WORDS} {LOAD_WORDS} {COMMAND_WORDS} error residual width"
)
FILLER_WORDS = _words(
    "pos position positions coord pose actual measured state ik of the observation "
    "field"
)
# per second, as in `deg/s` and `mm_per_s`
RATE_UNIT = re.compile(r"(/|_per_|\*\*-|\^-)\s*s")


@dataclass(frozen=True)
class ColumnMeaning:
    """The meaning of a column.

    Attributes
    ----------
    kind
        `time`, `frame`, `trial`, `label` (the name of a row's point), `joint`,
        `hand`, `point`, `arc` or `other`.
    name
        Number of a joint, or name of a point or of the hand.
    axis
        `x`, `y`, `z`, `angle`, a component of a quaternion, `likelihood`, `valid` or
        `sigma`.
    unit
        The unit in the column's name; empty if there is none.
    """

    kind: str
    name: str = ""
    axis: str = ""
    unit: str = ""


NO_MEANING = ColumnMeaning("other")


def split_words(column: str) -> list[str]:
    """Split a name into words and numbers, in lower case: `tipX [mm]` is tip, x, mm."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column)
    return re.findall(r"[a-z]+|\d+|°", spaced.lower())


def column_meaning(column: str) -> ColumnMeaning:
    """Interpret the name of a column."""
    words = split_words(column)
    if not words or NON_POSITION_WORDS & {*words} or _is_rate(column, words):
        return NO_MEANING
    unit = _unit_word(words)
    content = [word for word in words if word != unit or words.index(word) == 0]
    content = [word for word in content if word not in FILLER_WORDS] or content[:1]
    first = content[0]
    has_axis = not {"x", "y"}.isdisjoint(content)
    if row_kind := _row_kind(content):
        return ColumnMeaning(row_kind)
    is_time_unit = len(words) == 1 and first in TIME_UNITS and first != "s"
    if is_time_unit or (TIME_WORDS & {*content} and not has_axis):
        unit = first if is_time_unit else _unit_if_in(unit, TIME_UNITS)
        return ColumnMeaning("time", " ".join(content), unit=unit)
    if first in ARC_LENGTH_WORDS and len(content) <= 2 and not has_axis:
        return ColumnMeaning("arc", unit=_unit_if_in(unit, LENGTH_UNITS))
    # a message of joint states has an array of positions
    if len(content) == 1 and first.isdigit() and {"position", "positions"} & {*words}:
        return ColumnMeaning("joint", first, unit=_unit_if_in(unit, ANGLE_UNITS))
    return _position_meaning(content, unit)


def stated_unit(column: str, kind: str) -> str:
    """Find the unit in a column's name that fits its kind; empty if none."""
    unit = _unit_word(split_words(column))
    if unit in PIXEL_WORDS:
        return "px"
    suitable = {
        "time": TIME_UNITS,
        "joint": ANGLE_UNITS,
        "hand": LENGTH_UNITS | ANGLE_UNITS,
        "trial": {},
    }
    return _unit_if_in(unit, suitable.get(kind, LENGTH_UNITS))


def _row_kind(content: Sequence[str]) -> str:
    """Return `trial`, `frame` or `label` if a column names that of its row, or ""."""
    first, *others = content
    if first in TRIAL_WORDS and len(others) <= 1:
        return "trial"
    if first in FRAME_WORDS and INDEX_WORDS.issuperset(others):
        return "frame"
    if first in LABEL_WORDS and {*INDEX_WORDS, "name"}.issuperset(others):
        return "label"
    return ""


def _is_rate(column: str, words: Sequence[str]) -> bool:
    """Detect a unit per second, as in `deg/s` and `mm_s`."""
    if RATE_UNIT.search(column.lower()):
        return True
    return (
        len(words) > 2
        and words[-1] == "s"
        and words[-2] in {*LENGTH_UNITS, *ANGLE_UNITS}
    )


def _unit_word(words: Sequence[str]) -> str:
    """Find the last unit in a name, after its first word."""
    units = [word for word in words[1:] if word in UNITS]
    return units[-1] if units else ""


def _unit_if_in(unit: str, units: dict[str, float]) -> str:
    return unit if unit in units else ""


def _position_meaning(words: Sequence[str], unit: str) -> ColumnMeaning:
    """Interpret the name of a position: of a joint, the hand or a point."""
    if QUATERNION_WORDS & {*words} and words[-1] in {*"xyzw"}:
        body = [word for word in words[:-1] if word not in QUATERNION_WORDS]
        words = [*body, f"q{words[-1]}"]
    joint = _named_joint(words)
    if joint:
        return ColumnMeaning("joint", joint, unit=_unit_if_in(unit, ANGLE_UNITS))
    is_hand = not HAND_WORDS.isdisjoint(words)
    quaternion = [word for word in words if word in QUATERNION_AXES]
    quality = [QUALITY_WORDS[word] for word in words if word in QUALITY_WORDS]
    axes = [word for word in words if word in "xyz"]
    pixel_axes = [word for word in words if word in "uv"]
    if quaternion:
        if is_hand or len(words) == 1:
            return ColumnMeaning("hand", _point_name(words, quaternion), quaternion[0])
        return NO_MEANING
    if quality:
        name = _point_name(words, QUALITY_WORDS)
        return ColumnMeaning("point", name, quality[0], unit)
    if not axes and not pixel_axes:
        return _angle_meaning(words, unit, is_hand)
    if not axes:
        axis, unit = {"u": "x", "v": "y"}.get(pixel_axes[0], pixel_axes[0]), "px"
    else:
        axis = axes[0]
        unit = "px" if unit in PIXEL_WORDS else _unit_if_in(unit, LENGTH_UNITS)
    name = _point_name(words, ("x", "y", "z", "u", "v"))
    return ColumnMeaning("hand" if is_hand else "point", name, axis, unit)


def _named_joint(words: Sequence[str]) -> str:
    """Find the number of a joint named by body part; empty if there is none."""
    text = f" {' '.join(words)} "
    others = {"x", "y", "z", "u", "v", *QUATERNION_AXES, *QUALITY_WORDS}
    if not others.isdisjoint(words):
        return ""
    for name, number in NAMED_JOINTS:
        if f" {name} " in text:
            is_direction = name == "wrist" and DIRECTION_WORDS & {*words}
            return "" if is_direction else number
    return ""


def _angle_meaning(words: Sequence[str], unit: str, is_hand: bool) -> ColumnMeaning:
    """Interpret the name of an angle, of the hand or of a numbered joint."""
    numbers = [word for word in words if word.isdigit()]
    unit = _unit_if_in(unit, ANGLE_UNITS)
    is_alone = len(words) == 1 and not numbers
    if DIRECTION_WORDS & {*words} and (is_hand or is_alone):
        name = _point_name(words, [*DIRECTION_WORDS])
        return ColumnMeaning("hand", name, "angle", unit)
    if JOINT_WORDS & {*words} and numbers:
        return ColumnMeaning("joint", numbers[-1], unit=unit)
    return NO_MEANING


def _point_name(words: Sequence[str], leave_out: Sequence[str] | dict[str, str]) -> str:
    """Join the words of a point's name."""
    return " ".join(word for word in words if word not in leave_out)
