"""Draw a bench from a seed: string, casts, hidden cause and its size.

What is hidden moves the tip, somewhere in some trial, by a drawn number of noise
sigmas, counted after the base parameters are fitted anew, for what those can explain is
not there to be found. Strings and casts are redrawn until they can be predicted: swung
violently, limp strings are chaotic, and no model of whatever size would agree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.string import String
from tests.benchmarks.simulators.blind.aliasing import aliased
from tests.benchmarks.simulators.blind.bench import BlindBench
from tests.benchmarks.simulators.blind.casts import random_cast
from tests.benchmarks.simulators.blind.hidden import Hidden, hidden
from tests.benchmarks.simulators.blind.scene import Scene, unexplained
from tests.benchmarks.simulators.blind.version import (
    LATEST,
    NONE,
    PAIR,
    RESOLUTION,
    VERSIONS,
    Version,
)

SIZES = (6.0, 40.0)  # in sigmas
LEAST, MOST = 5.0, 60.0  # of a size as it turns out
APART = 6.0  # sigmas of each of a pair that the other cannot explain
UNLIKE = 5.0  # sigmas of an outside cause that no single effect of the library explains
AGREE = 5.0  # sigmas by which the tip may move between 21 and 29 points
# points with which sizes are sought, and with which what is really seen is explained
FEW, MORE = 21, 41
EXPLAINED = 2.5  # sigmas that the true cause may then leave
SPEEDS = (2.0, 10.0)  # of the hand [m/s]
# shares of an effect's range among which its size is sought
LADDER = np.geomspace(3e-3, 1.0, 12)
# share of the way to the end of its range at which a cause is hidden, at most
LARGEST = 0.9
NEIGHBOUR = 0.382  # share w of the neighbour's noise in that of a point
# of the fine string in a millisecond: strong dry friction would take it minutes
MOST_STEPS = 250


class Redraw(Exception):  # noqa: N818 - nothing has gone wrong
    """Raised where this string, these casts or this cause do not make the bench that is
    wanted.
    """


def draw(seed: int, arm: Arm, camera: Camera, version: int = LATEST) -> BlindBench:
    """The bench of a seed; `version` says which case it is (see `VERSIONS`)."""
    # no other use of this seed shall draw the same
    rng = np.random.default_rng([seed, 20211])
    while True:
        try:
            return _drawn(seed, VERSIONS[version], rng, arm, camera)
        except Redraw:
            continue


def _drawn(
    seed: int, version: Version, rng: np.random.Generator, arm: Arm, camera: Camera
) -> BlindBench:
    case = version.case(seed)
    scene = _scene(rng, arm, camera, version, soft=case == RESOLUTION)
    library = version.library()
    effects = [e for e in (*library, *version.causes()) if e.name == case]
    if case == PAIR:
        effects = [library[i] for i in rng.choice(len(library), 2, replace=False)]
    things = tuple(_hidden(effect, rng, scene) for effect in effects)
    data, parameters = _sized(scene, things, rng)
    if _kind(case, version) == "outside" and aliased(scene, data, UNLIKE):
        raise Redraw
    true, explained = _true(scene, things, parameters)
    sizes = _sizes(scene, things, explained, parameters, MORE)
    off = scene.at_tip(
        scene.left(
            scene.model(String(scene.length)), true, tuple(scene.base), {}, steps=4
        )[0]
    )
    if case == RESOLUTION:
        sizes = {RESOLUTION: off}
        if off < LEAST:
            raise Redraw
    # noise of unit variance, neighbours along the string correlated by a third: w / (1
    # + w^2) = 1/3
    white = rng.standard_normal((true.shape[0], true.shape[1] + 1, true.shape[2]))
    noise = (white[:, 1:] + NEIGHBOUR * white[:, :-1]) / np.hypot(1.0, NEIGHBOUR)
    points = scene.sigma * (true + noise)
    return BlindBench(
        seed,
        _kind(case, version),
        scene,
        things,
        parameters,
        sizes,
        off,
        points,
        bool(rng.integers(2)),
    )


def _kind(case: str, version: Version) -> str:
    """effect, outside, or what the case itself is."""
    if case in (NONE, PAIR, RESOLUTION):
        return case
    return "outside" if case in version.outside else "effect"


def _scene(
    rng: np.random.Generator, arm: Arm, camera: Camera, version: Version, soft: bool
) -> Scene:
    """A string, between B and C or about D, and three to five casts of it that can be
    predicted.
    """
    length, sigma = (
        rng.uniform(0.27, 0.33),
        float(np.exp(rng.uniform(*np.log([6e-4, 8e-4])))),
    )
    s = np.linspace(0.1, 1.0, int(rng.integers(15, 21))) * length
    scene = Scene(arm, camera, float(length), _string(rng, soft), (), s, sigma, version)
    casts, count = [], int(rng.integers(3, 6))
    for _ in range(40 * count):
        cast = random_cast(arm, rng, camera.fps, SPEEDS)
        alone = scene.performing((cast,))
        coarse, finer = (
            alone.seen(alone.model(alone.second_order(n)), [{}])[0] for n in (21, 29)
        )
        if alone.at_tip(finer - coarse) < AGREE:  # more points hardly move the tip
            casts.append(cast)
        if len(casts) == count:
            return scene.performing(tuple(casts))
    raise Redraw


def _string(rng: np.random.Generator, soft: bool) -> dict[str, float]:
    """The paper's parameters, per mass point at n = 10."""

    def about(value: float, factor: float) -> float:
        return float(value * factor ** rng.uniform(-1, 1))

    low, high = (0.03, 0.15) if soft else (0.8, 20.0)
    bending = float(np.exp(rng.uniform(*np.log([low, high]))))
    return {
        "axial_stiffness": about(6e5, 1.4),
        "axial_damping": about(30.0, 2.0),
        "bending_stiffness": bending,
        "bending_damping": about(2.2e-3 * np.sqrt(bending), 1.5),
        "linear_drag": about(0.3, 1.8),
        "quadratic_drag": about(0.2, 1.8),
        "grasp_stiffness": min(about(0.9 * bending**0.7, 1.4), 4.5),
        "grasp_damping": about(5e-3, 1.8),
    }


def _hidden(effect: type[Effect], rng: np.random.Generator, scene: Scene) -> Hidden:
    """The effect in circumstances of this scene's trials."""
    plain = scene.model(scene.second_order(FEW))
    values = plain.values(scene.base)[None]
    times = [cast.frames for cast in scene.casts]
    strings = [
        plain.simulate_string(cast.happened, values, cast.frames).points[0]
        for cast in scene.casts
    ]
    thing = hidden(effect, rng, times, strings)
    if thing is None:
        raise Redraw
    return thing


def _sized(
    scene: Scene, things: Sequence[Hidden], rng: np.random.Generator
) -> tuple[np.ndarray, dict[str, float]]:
    """The points seen with hidden causes of drawn sizes, simulated with few points (N,
    S, 2), and their parameters.
    """
    parameters: dict[str, float] = {}
    for thing in things:
        parameters |= thing.at(
            _share(scene, thing, float(np.exp(rng.uniform(*np.log(SIZES)))))
        )
    light = scene.model(scene.second_order(FEW), [t.effect for t in things])
    only = things[0].only if len(things) == 1 else None
    data = scene.seen(light, [parameters], only)[0]
    if not np.isfinite(data).all():
        raise Redraw
    # too small or too large a thing is redrawn before it costs more
    _sizes(scene, things, data, parameters, FEW)
    return data, parameters


def _sizes(
    scene: Scene,
    things: Sequence[Hidden],
    data: np.ndarray,
    parameters: dict[str, float],
    points: int,
) -> dict[str, float]:
    """How far each thing moves the tip at most, in sigmas, of what is seen with so many
    points (N, S, 2): what base parameters and the other things leave.
    """
    sizes = {}
    for thing in things:
        others = [other for other in things if other is not thing]
        start = {
            name: value
            for other in others
            for name, value in parameters.items()
            if name in other.full
        }
        model = scene.model(
            scene.second_order(points), [other.effect for other in others]
        )
        rest, _ = scene.left(model, data, (*scene.base, *start), start, steps=3)
        sizes[thing.effect.name] = scene.at_tip(rest)
    least = LEAST if len(things) == 1 else APART
    if not all(least <= size <= MOST for size in sizes.values()):
        raise Redraw
    return sizes


def _share(scene: Scene, thing: Hidden, wanted: float) -> float:
    """The share of an effect's range at which it moves the tip by so many sigmas beyond
    what the base explains.
    """
    model = scene.model(scene.second_order(FEW), [thing.effect])
    fields = scene.seen(
        model, [thing.absent, *(thing.at(share) for share in LADDER)], thing.only
    )
    plain, slopes = scene.slopes(
        scene.model(scene.second_order(FEW)), scene.base, tuple(scene.base)
    )
    sizes = [scene.at_tip(f) for f in unexplained(fields[1:] - plain, slopes)]
    finite = np.isfinite(sizes)
    rising = np.maximum.accumulate(np.where(finite, sizes, 0.0))
    if rising[-1] < LEAST:
        raise Redraw
    share = np.exp(
        np.interp(np.log(wanted), np.log(np.maximum(rising, 1e-9)), np.log(LADDER))
    )
    return float(min(share, LARGEST))


def _true(
    scene: Scene, things: Sequence[Hidden], parameters: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The true points in sigmas, and those that the true cause explains with fewer mass
    points, (N, S, 2) each.
    """
    effects = [t.effect for t in things]
    only = things[0].only if len(things) == 1 else None
    fine = scene.model(scene.fine, effects)
    if scene.steps(fine, parameters) > MOST_STEPS:
        raise Redraw
    true = scene.seen(fine, [parameters], only)[0]
    if not np.isfinite(true).all():
        raise Redraw
    again = scene.model(scene.second_order(MORE), effects)
    rest, _ = scene.left(
        again, true, (*scene.base, *parameters), parameters, steps=1, only=only
    )
    if scene.at_tip(rest) > EXPLAINED:
        raise Redraw
    return true, true - rest
