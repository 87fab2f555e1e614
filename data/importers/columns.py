"""The meaning of a column from its name: `joint1_deg`, `Time (Seconds)`, `tip_x_mm`,
`actual_TCP_pose_0`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

TIME_UNITS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0} | {
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosecond", "nanoseconds"), 1e-9),
}
LENGTH_UNITS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetres"), 1e-3),
    "um": 1e-6,
}
ANGLE_UNITS = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), pi / 180),
    "mrad": 1e-3,
}
PIXEL_WORDS = ("px", "pixel", "pixels")
TIME_WORDS = ("t", "time", "times", "timestamp", "stamp")
TRIAL_WORDS = ("trial", "episode", "run", "take", "cast", "shot", "recording")
JOINT_WORDS = ("joint", "q", "j", "axis", "a", "motor", "servo", "angle", "theta")
HAND_WORDS = (
    "tcp",
    "hand",
    "grasp",
    "gripper",
    "ee",
    "eef",
    "effector",
    "tool",
    "wrist",
    "flange",
    "clamp",
)
DIRECTION_WORDS = (
    "theta",
    "yaw",
    "angle",
    "phi",
    "heading",
    "rz",
    "rotation",
    "orientation",
)
QUATERNION_AXES = ("qx", "qy", "qz", "qw")
ARC_LENGTH_WORDS = ("s", "arc", "arclength")
QUALITY_WORDS = {
    **dict.fromkeys(("likelihood", "confidence", "score"), "likelihood"),
    **dict.fromkeys(("valid", "visible", "tracked"), "valid"),
    **dict.fromkeys(("sigma", "std", "uncertainty"), "sigma"),
}
RATE_WORDS = (
    "vel",
    "velocity",
    "velocities",
    "speed",
    "acc",
    "acceleration",
    "jerk",
    "qd",
    "qdd",
    "rate",
)
LOAD_WORDS = (
    "torque",
    "effort",
    "force",
    "current",
    "voltage",
    "temperature",
    "moment",
    "power",
)
COMMAND_WORDS = (
    "cmd",
    "command",
    "commanded",
    "target",
    "goal",
    "desired",
    "setpoint",
    "reference",
    "ref",
    "action",
)
NON_POSITION_WORDS = {
    *RATE_WORDS,
    *LOAD_WORDS,
    *COMMAND_WORDS,
    "error",
    "residual",
    "width",
}
FILLER_WORDS = {
    "pos",
    "position",
    "positions",
    "coord",
    "pose",
    "actual",
    "measured",
    "state",
    "ik",
    "of",
    "the",
    "observation",
}


@dataclass(frozen=True)
class ColumnMeaning:
    """The meaning of a column.

    kind: `time`, `frame`, `trial`, `joint`, `hand`, `point`, `arc` or `other`. name:
    number of a joint, name of a point. axis: x, y, z, angle, a quaternion's, or
    likelihood, valid, sigma. unit: from the column's name; empty where it gives none.
    """

    kind: str
    name: str = ""
    axis: str = ""
    unit: str = ""


NO_MEANING = ColumnMeaning("other")


def split_words(column: str) -> list[str]:
    """Words and numbers that a name is made of, in lower case: `tipX [mm]` is tip, x,
    mm.
    """
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column)
    return re.findall(r"[a-z]+|\d+|°", apart.lower())


def column_meaning(column: str) -> ColumnMeaning:
    """The meaning of a column, as far as its name tells."""
    words = split_words(column)
    # a unit that is one per second, as in `deg/s` and `mm_s`, is a rate's
    over = re.search(r"(/|_per_|\*\*-|\^-)\s*s", column.lower())
    is_rate = over or (
        len(words) > 2
        and words[-1] == "s"
        and words[-2] in {*LENGTH_UNITS, *ANGLE_UNITS}
    )
    if not words or NON_POSITION_WORDS & {*words} or is_rate:
        return NO_MEANING
    unit = _unit_word(words)
    plain = [word for word in words if word != unit or words.index(word) == 0]
    plain = [word for word in plain if word not in FILLER_WORDS] or plain[:1]
    if plain[0] in TRIAL_WORDS and len(plain) <= 2:
        return ColumnMeaning("trial")
    if plain in (["frame"], ["frame", "index"], ["frame", "number"]):
        return ColumnMeaning("frame")
    if {*TIME_WORDS} & {*plain} and not {"x", "y"} & {*plain}:
        return ColumnMeaning(
            "time", " ".join(plain), "", unit if unit in TIME_UNITS else ""
        )
    if plain[0] in ARC_LENGTH_WORDS and len(plain) <= 2 and not {"x", "y"} & {*plain}:
        return ColumnMeaning("arc", "", "", unit if unit in LENGTH_UNITS else "")
    return _position_meaning(plain, unit)


def _unit_word(words: Sequence[str]) -> str:
    """The unit that a name ends with, if any: the last word but for numbers."""
    found = [
        word
        for word in words[1:]
        if word in {*TIME_UNITS, *LENGTH_UNITS, *ANGLE_UNITS, *PIXEL_WORDS}
    ]
    return found[-1] if found else ""


def stated_unit(column: str, kind: str) -> str:
    """The unit that a column's name says, of a kind of meaning."""
    unit = _unit_word(split_words(column))
    known = {
        "time": TIME_UNITS,
        "joint": ANGLE_UNITS,
        "hand": LENGTH_UNITS | ANGLE_UNITS,
        "trial": (),
    }.get(kind, LENGTH_UNITS)
    return "px" if unit in PIXEL_WORDS else unit if unit in known else ""


def _position_meaning(plain: Sequence[str], unit: str) -> ColumnMeaning:
    """The meaning of a column of positions: of a joint, the hand or a point of the
    string.
    """
    of_hand = bool({*HAND_WORDS} & {*plain})
    if turned := [word for word in plain if word in QUATERNION_AXES]:
        return (
            ColumnMeaning("hand", "", turned[0])
            if of_hand or len(plain) == 1
            else NO_MEANING
        )
    if quality := [QUALITY_WORDS[word] for word in plain if word in QUALITY_WORDS]:
        return ColumnMeaning(
            "point", _point_name(plain, QUALITY_WORDS), quality[0], unit
        )
    if axes := [word for names in ("xyz", "uv") for word in plain if word in names]:
        # u and v are x and y in pixels
        in_pixels = axes[0] in "uv" or unit in PIXEL_WORDS
        unit = "px" if in_pixels else unit if unit in LENGTH_UNITS else ""
        axis = {"u": "x", "v": "y"}.get(axes[0], axes[0])
        return ColumnMeaning(
            "hand" if of_hand else "point",
            _point_name(plain, ("x", "y", "z", "u", "v")),
            axis,
            unit,
        )
    # no coordinate: the hand's direction, or the angle of a numbered joint
    numbers = [word for word in plain if word.isdigit()]
    unit = unit if unit in ANGLE_UNITS else ""
    if {*DIRECTION_WORDS} & {*plain} and (of_hand or (len(plain) == 1 and not numbers)):
        return ColumnMeaning("hand", "", "angle", unit)
    return (
        ColumnMeaning("joint", numbers[-1], "", unit)
        if {*JOINT_WORDS} & {*plain} and numbers
        else NO_MEANING
    )


def _point_name(plain: Sequence[str], beside: Sequence[str] | dict[str, str]) -> str:
    """A point's name: all words but those."""
    return " ".join(word for word in plain if word not in beside)
