"""Causes that may be hidden, their circumstances, and their names in the library.

A cause grows from absent to full; its size is searched later, in millimetres at the
tip. Its settings are fields of `Rod`, `HandFaults` and `CameraFaults`, by name with
`rod.`, `hand.` or `camera.` in front. The own kernel hides the library's effects by
their parameters instead (`own_kernel.py`), and causes outside the library by these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.simulators.rod import Rod

Settings = dict[str, float]
Ends = tuple[Settings, Settings]  # settings of an absent and of a full cause
MAX_PEG_RADIUS_M = 0.04
PEG_PLACES = 50  # number of places that are tried
CLEARANCE_M = 0.012  # distance of an obstacle from the hand and the string at rest
MIN_PLANE_TRAVEL_M = 0.03


@dataclass(frozen=True)
class PlainTrials:
    """Trials without any cause.

    Parameters
    ----------
    rod : the string
    times : (F,) frame times of each trial [s]
    strings : (F, S, 2) of each trial [m], the first point at the grasp
    hands : (K, 2) places of the hand in each trial [m]
    """

    rod: Rod
    times: tuple[np.ndarray, ...]
    strings: tuple[np.ndarray, ...]
    hands: tuple[np.ndarray, ...]


DrawEnds = Callable[[np.random.Generator, PlainTrials, int], "Ends | None"]
Comparable = Callable[[Mapping[str, float]], Settings]


@dataclass(frozen=True)
class Cause:
    """A cause that may be hidden.

    Parameters
    ----------
    name : the library's name for it, or its own if it is outside the library
    draw_ends : draws absent and full settings, given plain trials and the number of the
        trial in which it acts; None where there are no suitable circumstances
    outside : it is not in the library
    alike : other names of the library that are as right
    parameters : parameters of the library that mean the same, from settings
    once : it acts in one trial only
    directions : number of circumstances in which it is compared with an outside cause
    size_factor : how many times larger than others it is hidden
    """

    name: str
    draw_ends: DrawEnds
    outside: bool = False
    alike: tuple[str, ...] = ()
    parameters: Comparable = lambda settings: {}
    once: bool = False
    directions: int = 1
    size_factor: float = 1.0

    def hide(self, rng: np.random.Generator, trials: PlainTrials) -> HiddenCause | None:
        """Draw circumstances that fit the trials, or None where there are none."""
        trial = int(rng.integers(len(trials.times)))
        ends = self.draw_ends(rng, trials, trial)
        if ends is None:
            return None
        return HiddenCause(self, *ends, only_trial=trial if self.once else None)


@dataclass(frozen=True)
class HiddenCause:
    """A cause in its circumstances, between absent and full.

    `only_trial` is the number of the one trial in which it acts, None for all.
    """

    cause: Cause
    absent: Settings
    full: Settings
    only_trial: int | None = None

    def settings(self, share: float) -> Settings:
        """Return the settings at a share of the way from absent to full."""
        settings = {}
        for name, end in self.full.items():
            begin = self.absent[name]
            settings[name] = begin + share * (end - begin)
        return settings


def grow(name: str, *ends: float, **others: tuple[float, float]) -> DrawEnds:
    """Let a setting grow from zero to one of its ends, others drawn from ranges."""

    def draw(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
        same = _draw_others(rng, name, others)
        return {name: 0.0, **same}, {name: float(rng.choice(ends)), **same}

    return draw


def grow_vector(x: str, y: str, size: float, **others: tuple[float, float]) -> DrawEnds:
    """Let a vector grow from zero in any direction, others drawn from ranges."""

    def draw(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
        direction = rng.uniform(-np.pi, np.pi)
        same = _draw_others(rng, x, others)
        full = {x: size * float(np.cos(direction)), y: size * float(np.sin(direction))}
        return {x: 0.0, y: 0.0, **same}, {**full, **same}

    return draw


def _draw_others(
    rng: np.random.Generator, name: str, ranges: Mapping[str, tuple[float, float]]
) -> Settings:
    prefix = name.partition(".")[0]
    return {f"{prefix}.{other}": float(rng.uniform(*r)) for other, r in ranges.items()}


def at_arc_length(draw: DrawEnds, name: str, first: float, last: float) -> DrawEnds:
    """Let a cause act at a place between two shares of the string's length."""

    def draw_along(
        rng: np.random.Generator, trials: PlainTrials, trial: int
    ) -> Ends | None:
        ends = draw(rng, trials, trial)
        same = {name: float(rng.uniform(first, last)) * trials.rod.length}
        return ends and (ends[0] | same, ends[1] | same)

    return draw_along


def during(draw: DrawEnds, begin_name: str, end_name: str | None = None) -> DrawEnds:
    """Let a cause act from some time of the trial on, until another if it ends."""

    def draw_timed(
        rng: np.random.Generator, trials: PlainTrials, trial: int
    ) -> Ends | None:
        ends = draw(rng, trials, trial)
        begin = float(rng.uniform(0.25, 0.6) * trials.times[trial][-1])
        same = {begin_name: begin}
        if end_name is not None:
            same[end_name] = begin + float(rng.uniform(0.06, 0.15))
        return ends and (ends[0] | same, ends[1] | same)

    return draw_timed


def where_string_passes(draw: DrawEnds, x: str, y: str) -> DrawEnds:
    """Let a cause act at a place that the outer half of the moving string passes."""

    def draw_placed(
        rng: np.random.Generator, trials: PlainTrials, trial: int
    ) -> Ends | None:
        ends = draw(rng, trials, trial)
        string = trials.strings[trial]
        frame = int(rng.uniform(0.3, 0.7) * len(string))
        point = rng.integers(string.shape[1] // 2, string.shape[1])
        place = string[frame, point]
        same = {x: float(place[0]), y: float(place[1])}
        return ends and (ends[0] | same, ends[1] | same)

    return draw_placed


def plane_positions(
    rng: np.random.Generator, trials: PlainTrials
) -> tuple[float, float, float] | None:
    """Draw a plane of any tilt that the string may touch.

    Returns
    -------
    Its tilt [rad], the height at which the string just touches it, and that at which
    hand and resting string just keep clear of it [m]; None if these are too close.
    """
    tilt = float(rng.uniform(-np.pi, np.pi))
    normal = np.array([-np.sin(tilt), np.cos(tilt)])
    touched = min(float((points @ normal).min()) for points in trials.strings)
    resting = min(float((points[0] @ normal).min()) for points in trials.strings)
    hand = min(float((places @ normal).min()) for places in trials.hands)
    highest = min(resting, hand) - CLEARANCE_M
    if highest - touched < MIN_PLANE_TRAVEL_M:
        return None
    return tilt, touched, highest


def _plane(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends | None:
    """Let a floor or a wall come closer from where the string just touches it."""
    positions = plane_positions(rng, trials)
    if positions is None:
        return None
    tilt, touched, highest = positions
    same = {
        "rod.plane": float(np.exp(rng.uniform(*np.log([3e4, 6e5])))),
        "rod.plane_x": float(-np.sin(tilt)),
        "rod.plane_y": float(np.cos(tilt)),
        "rod.plane_friction": float(rng.uniform(0, 0.5)),
        "rod.plane_loss": float(rng.uniform(0, 60)),
    }
    return {"rod.plane_height": touched, **same}, {"rod.plane_height": highest, **same}


def _plane_parameters(settings: Mapping[str, float]) -> Settings:
    tilt = np.arctan2(-settings["rod.plane_x"], settings["rod.plane_y"])
    return {"contact.height": settings["rod.plane_height"], "contact.tilt": float(tilt)}


def _friction(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
    """Let friction grow to the moment that bending has at 20 /m."""
    curvature = float(np.exp(rng.uniform(*np.log([0.5, 3.0]))))
    same = {"rod.friction_curvature": curvature}
    full = {"rod.friction": 20 * trials.rod.bending, **same}
    return {"rod.friction": 0.0, **same}, full


def _relaxing_stiffness(
    rng: np.random.Generator, trials: PlainTrials, trial: int
) -> Ends:
    """Let a relaxing stiffness grow to five times the one that stays."""
    same = {"rod.relaxation_time": float(np.exp(rng.uniform(*np.log([0.05, 0.3]))))}
    full = {"rod.relaxing_stiffness": 5 * trials.rod.bending, **same}
    return {"rod.relaxing_stiffness": 0.0, **same}, full


def _backlash(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
    """Let play grow in one joint, or in each by a share of its own."""
    in_one = rng.integers(2)
    shares = np.eye(3)[rng.integers(3)] if in_one else rng.uniform(size=3)
    full = {f"hand.gap_{j + 1}": 0.1 * float(share) for j, share in enumerate(shares)}
    return dict.fromkeys(full, 0.0), full


def _slip(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
    """Let the string slip either way, within the movement of the shortest trial."""
    shortest = min(times[-1] for times in trials.times)
    begin = float(rng.uniform(0.2, 0.5) * shortest)
    end = begin + float(rng.uniform(0.1, 1.0) * shortest)
    same = {"hand.slip_from": begin, "hand.slip_until": end}
    full = {"hand.slip": 0.3 * float(rng.choice([-1, 1])), **same}
    return {"hand.slip": 0.0, **same}, full


def _peg(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends | None:
    """Let a round peg grow where the string passes.

    It is clear of the hand and the string at rest.
    """
    kept_clear = np.concatenate([trials.strings[trial][0], trials.hands[trial]])
    stiffness = {"rod.peg": float(np.exp(rng.uniform(*np.log([3e4, 3e5]))))}
    radius = grow("rod.peg_radius", MAX_PEG_RADIUS_M)
    draw = where_string_passes(radius, "rod.peg_x", "rod.peg_y")
    for _ in range(PEG_PLACES):
        ends = draw(rng, trials, trial)
        assert ends is not None
        centre = np.array([ends[0]["rod.peg_x"], ends[0]["rod.peg_y"]])
        distance = np.linalg.norm(kept_clear - centre, axis=-1).min()
        if distance > MAX_PEG_RADIUS_M + CLEARANCE_M:
            return ends[0] | stiffness, ends[1] | stiffness
    return None


def _thread(rng: np.random.Generator, trials: PlainTrials, trial: int) -> Ends:
    """Let a thread hold the tip, taut beyond half of its largest distance from rest."""
    tips = trials.strings[trial][:, -1]
    farthest = float(np.linalg.norm(tips - tips[0], axis=-1).max())
    same = {
        "rod.thread_x": float(tips[0, 0]),
        "rod.thread_y": float(tips[0, 1]),
        "rod.thread_slack": 0.5 * farthest,
    }
    return {"rod.thread": 0.0, **same}, {"rod.thread": 3e3, **same}


def _rename_settings(**names: str) -> Comparable:
    """Map settings to parameters of the library; `__` stands for a dot."""
    pairs = [(to.replace("__", "."), setting) for to, setting in names.items()]
    return lambda settings: {parameter: settings[name] for parameter, name in pairs}


LIBRARY_CAUSES = (
    Cause(
        "tip_mass",
        grow("rod.tip_mass", 0.6),
        parameters=_rename_settings(tip_mass__ratio="rod.tip_mass"),
    ),
    Cause(
        "density_taper",
        grow("rod.taper", -1.5, 1.5),
        parameters=_rename_settings(density_taper__taper="rod.taper"),
    ),
    Cause(
        "rest_curvature",
        grow("rod.rest_curvature", -20.0, 20.0),
        parameters=_rename_settings(rest_curvature__curvature="rod.rest_curvature"),
    ),
    # M = B k (1 + |h| k^2)^(+-1/2) is half as much again, or two thirds, at 20 /m
    Cause("nonlinear_bending", grow("rod.hardening", -6e-3, 6e-3)),
    # Bouc and Wen's law comes near to its largest moment as neither of these two does.
    Cause("maxwell_slip", _friction, alike=("dahl_friction",)),
    Cause(
        "standard_linear_solid",
        _relaxing_stiffness,
        parameters=_rename_settings(
            standard_linear_solid__stiffness="rod.relaxing_stiffness",
            standard_linear_solid__relaxation="rod.relaxation_time",
        ),
    ),
    Cause("anisotropic_drag", grow("rod.cross_drag", 8.0)),
    Cause(
        "wind",
        grow_vector("rod.wind_x", "rod.wind_y", 3.0),
        parameters=_rename_settings(
            wind__along_x="rod.wind_x", wind__along_y="rod.wind_y"
        ),
        directions=2,
    ),
    Cause(
        "gravity_direction",
        grow("rod.gravity_x", -0.1 * 9.81, 0.1 * 9.81),
        parameters=lambda settings: {
            "gravity_direction.tilt": float(np.arctan2(settings["rod.gravity_x"], 9.81))
        },
    ),
    Cause("contact", _plane, parameters=_plane_parameters, directions=3),
    Cause(
        "arm_lag",
        grow("hand.lag", 0.08),
        parameters=_rename_settings(arm_lag__time_constant="hand.lag"),
    ),
    Cause(
        "joint_gain",
        grow("hand.gain", -0.2, 0.2),
        parameters=_rename_settings(joint_gain__gain="hand.gain"),
    ),
    Cause(
        "backlash",
        _backlash,
        parameters=_rename_settings(
            backlash__gap_1="hand.gap_1",
            backlash__gap_2="hand.gap_2",
            backlash__gap_3="hand.gap_3",
        ),
        directions=3,
    ),
    Cause(
        "grasp_angle",
        grow("hand.angle", -0.8, 0.8),
        parameters=_rename_settings(grasp_angle__angle="hand.angle"),
    ),
    Cause(
        "grasp_slip",
        _slip,
        parameters=_rename_settings(
            grasp_slip__speed="hand.slip", grasp_slip__onset="hand.slip_from"
        ),
        directions=2,
    ),
    Cause(
        "time_offset",
        grow("camera.offset", -0.05, 0.05),
        parameters=_rename_settings(time_offset__offset="camera.offset"),
    ),
    Cause(
        "clock_drift",
        grow("camera.drift", -0.05, 0.05),
        parameters=_rename_settings(clock_drift__rate="camera.drift"),
    ),
    Cause(
        "camera_rotation",
        grow("camera.roll", -0.2, 0.2),
        parameters=_rename_settings(camera_rotation__angle="camera.roll"),
    ),
    Cause(
        "pixel_scale",
        grow("camera.scale", -0.1, 0.1),
        parameters=_rename_settings(pixel_scale__excess="camera.scale"),
    ),
    # No polynomial is equal to this lens, which divides.
    Cause("lens_distortion", grow("camera.lens", -0.2, 0.2)),
    Cause(
        "rolling_shutter",
        grow("camera.readout", -0.02, 0.02),
        parameters=_rename_settings(rolling_shutter__readout="camera.readout"),
    ),
)


def _outside(
    name: str, draw_ends: DrawEnds, once: bool = False, size_factor: float = 1.0
) -> Cause:
    return Cause(name, draw_ends, outside=True, once=once, size_factor=size_factor)


OUTSIDE_STRING_CAUSES = (
    _outside("stiffness_taper", grow("rod.stiffness_taper", -1.8, 1.8)),
    _outside(
        "soft_spot",
        at_arc_length(grow("rod.soft_spot", 0.95), "rod.soft_spot_place", 0.3, 0.7),
    ),
    _outside(
        "bead", at_arc_length(grow("rod.bead_mass", 1.0), "rod.bead_place", 0.35, 0.7)
    ),
    _outside("flag", grow("rod.flag", 1.0)),
    _outside("drag_drop", grow("rod.drag_drop", 0.95, drag_drop_speed=(1.5, 4.0))),
    _outside(
        "flutter",
        grow_vector(
            "rod.flutter_x", "rod.flutter_y", 12.0, flutter_frequency=(2.0, 8.0)
        ),
    ),
    _outside(
        "loose_grasp", during(grow("rod.grasp_loss", 60.0), "rod.grasp_loss_from")
    ),
    _outside(
        "attraction",
        where_string_passes(
            grow("rod.attraction", -300.0, 300.0, attraction_reach=(0.05, 0.12)),
            "rod.attraction_x",
            "rod.attraction_y",
        ),
    ),
    _outside(
        "vortex",
        where_string_passes(
            grow("rod.vortex", -25.0, 25.0, vortex_core=(0.08, 0.2)),
            "rod.vortex_x",
            "rod.vortex_y",
        ),
    ),
    _outside("peg", _peg, once=True),
    _outside("thread", _thread, once=True),
    _outside(
        "gust",
        during(
            grow_vector("rod.gust_x", "rod.gust_y", 25.0, gust_lasts=(0.04, 0.1)),
            "rod.gust_when",
        ),
        once=True,
    ),
    _outside(
        "blow",
        during(
            at_arc_length(
                grow_vector("rod.blow_x", "rod.blow_y", 1500.0),
                "rod.blow_place",
                0.45,
                0.9,
            ),
            "rod.blow_when",
        ),
        once=True,
    ),
    _outside(
        "grip",
        during(
            at_arc_length(grow("rod.grip", 2e3), "rod.grip_place", 0.4, 0.9),
            "rod.grip_from",
            "rod.grip_until",
        ),
        once=True,
    ),
)
OUTSIDE_ARM_AND_CAMERA_CAUSES = (
    _outside(
        "sticking_joint",
        during(grow("hand.sticking", 0.15), "hand.sticking_from"),
        once=True,
    ),
    _outside("joint_offset", grow("hand.joint_offset", -0.15, 0.15)),
    _outside("ringing", grow("hand.ringing", 1.5e-3)),
    _outside("link_excess", grow("hand.link_excess", -0.05, 0.05)),
    _outside(
        "shaking_base",
        grow(
            "hand.shaking",
            0.02,
            shaking_direction=(-3.1, 3.1),
            shaking_frequency=(4.0, 12.0),
        ),
    ),
    _outside(
        "clock_jump",
        during(grow("camera.jump", -0.05, 0.05), "camera.jump_when"),
        once=True,
    ),
    _outside(
        "camera_knock",
        during(
            grow_vector("camera.knock_x", "camera.knock_y", 0.05), "camera.knock_when"
        ),
        once=True,
    ),
    _outside(
        "camera_shake",
        grow_vector(
            "camera.shake_x", "camera.shake_y", 0.03, shake_frequency=(4.0, 15.0)
        ),
    ),
    # An effect of the library explains most of it.
    _outside(
        "perspective",
        grow_vector("camera.perspective_x", "camera.perspective_y", 0.25),
        size_factor=4.0,
    ),
    _outside("unlike_axes", grow("camera.stretch", -0.1, 0.1)),
    _outside("length_error", grow("camera.length_error", -0.12)),
)
OUTSIDE_CAUSES = (*OUTSIDE_STRING_CAUSES, *OUTSIDE_ARM_AND_CAMERA_CAUSES)
