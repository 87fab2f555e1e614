"""The meaning of a column from its name: `joint1_deg`, `Time (Seconds)`, `tip_x_mm`, `actual_TCP_pose_0`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

TIMES = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0} | {
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosecond", "nanoseconds"), 1e-9),
}
LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), 1e-2),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetres"), 1e-3),
    "um": 1e-6,
}
ANGLES = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), pi / 180),
    "mrad": 1e-3,
}
PIXELS = ("px", "pixel", "pixels")
TIME = ("t", "time", "times", "timestamp", "stamp")
TRIAL = ("trial", "episode", "run", "take", "cast", "shot", "recording")
JOINT = ("joint", "q", "j", "axis", "a", "motor", "servo", "angle", "theta")
HAND = ("tcp", "hand", "grasp", "gripper", "ee", "eef", "effector", "tool", "wrist", "flange", "clamp")
ANGLE = ("theta", "yaw", "angle", "phi", "heading", "rz", "rotation", "orientation")
QUATERNION = ("qx", "qy", "qz", "qw")
ARC = ("s", "arc", "arclength")
QUALITY = {
    **dict.fromkeys(("likelihood", "confidence", "score"), "likelihood"),
    **dict.fromkeys(("valid", "visible", "tracked"), "valid"),
    **dict.fromkeys(("sigma", "std", "uncertainty"), "sigma"),
}
RATES = ("vel", "velocity", "velocities", "speed", "acc", "acceleration", "jerk", "qd", "qdd", "rate")
LOADS = ("torque", "effort", "force", "current", "voltage", "temperature", "moment", "power")
WISHES = ("cmd", "command", "commanded", "target", "goal", "desired", "setpoint", "reference", "ref", "action")
NO_POSITION = {*RATES, *LOADS, *WISHES, "error", "residual", "width"}
FILLERS = {
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
class Meaning:
    """The meaning of a column.

    kind: `time`, `frame`, `trial`, `joint`, `hand`, `point`, `arc` or `other`. name: number of a joint, name of a
    point. axis: x, y, z, angle, a quaternion's, or likelihood, valid, sigma. unit: from the column's name; empty where
    it gives none.
    """

    kind: str
    name: str = ""
    axis: str = ""
    unit: str = ""


OTHER = Meaning("other")


def words_of(column: str) -> list[str]:
    """Words and numbers that a name is made of, in lower case: `tipX [mm]` is tip, x, mm."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column)
    return re.findall(r"[a-z]+|\d+|°", apart.lower())


def meaning(column: str) -> Meaning:
    """The meaning of a column, as far as its name tells."""
    words = words_of(column)
    # a unit that is one per second, as in `deg/s` and `mm_s`, is a rate's
    over = re.search(r"(/|_per_|\*\*-|\^-)\s*s", column.lower())
    is_rate = over or (len(words) > 2 and words[-1] == "s" and words[-2] in {*LENGTHS, *ANGLES})
    if not words or NO_POSITION & {*words} or is_rate:
        return OTHER
    unit = _unit(words)
    plain = [word for word in words if word != unit or words.index(word) == 0]
    plain = [word for word in plain if word not in FILLERS] or plain[:1]
    if plain[0] in TRIAL and len(plain) <= 2:
        return Meaning("trial")
    if plain in (["frame"], ["frame", "index"], ["frame", "number"]):
        return Meaning("frame")
    if {*TIME} & {*plain} and not {"x", "y"} & {*plain}:
        return Meaning("time", " ".join(plain), "", unit if unit in TIMES else "")
    if plain[0] in ARC and len(plain) <= 2 and not {"x", "y"} & {*plain}:
        return Meaning("arc", "", "", unit if unit in LENGTHS else "")
    return _placed(plain, unit)


def _unit(words: Sequence[str]) -> str:
    """The unit that a name ends with, if any: the last word but for numbers."""
    found = [word for word in words[1:] if word in {*TIMES, *LENGTHS, *ANGLES, *PIXELS}]
    return found[-1] if found else ""


def unit_in(column: str, kind: str) -> str:
    """The unit that a column's name says, of a kind of meaning."""
    unit = _unit(words_of(column))
    known = {"time": TIMES, "joint": ANGLES, "hand": LENGTHS | ANGLES, "trial": ()}.get(kind, LENGTHS)
    return "px" if unit in PIXELS else unit if unit in known else ""


def _placed(plain: Sequence[str], unit: str) -> Meaning:
    """The meaning of a column of positions: of a joint, the hand or a point of the string."""
    of_hand = bool({*HAND} & {*plain})
    if turned := [word for word in plain if word in QUATERNION]:
        return Meaning("hand", "", turned[0]) if of_hand or len(plain) == 1 else OTHER
    if quality := [QUALITY[word] for word in plain if word in QUALITY]:
        return Meaning("point", _named(plain, QUALITY), quality[0], unit)
    if axes := [word for names in ("xyz", "uv") for word in plain if word in names]:
        in_pixels = axes[0] in "uv" or unit in PIXELS  # u and v are x and y in pixels
        unit = "px" if in_pixels else unit if unit in LENGTHS else ""
        axis = {"u": "x", "v": "y"}.get(axes[0], axes[0])
        return Meaning("hand" if of_hand else "point", _named(plain, ("x", "y", "z", "u", "v")), axis, unit)
    # no coordinate: the hand's direction, or the angle of a numbered joint
    numbers = [word for word in plain if word.isdigit()]
    unit = unit if unit in ANGLES else ""
    if {*ANGLE} & {*plain} and (of_hand or (len(plain) == 1 and not numbers)):
        return Meaning("hand", "", "angle", unit)
    return Meaning("joint", numbers[-1], "", unit) if {*JOINT} & {*plain} and numbers else OTHER


def _named(plain: Sequence[str], beside: Sequence[str] | dict[str, str]) -> str:
    """A point's name: all words but those."""
    return " ".join(word for word in plain if word not in beside)
