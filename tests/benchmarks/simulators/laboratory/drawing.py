"""Draw a bench of a laboratory from a seed: string, casts, what is hidden and how
large.

A cause is as large as a drawn number of millimetres at the tip, root mean square over
all frames, counted after what the string's base parameters (and the other causes)
explain, linearised about the truth. What is measured is simulated twice, the second
time with a coarser mesh and step: a trial that is not known to a third of the noise is
redrawn and counted; some benches keep one such trial among good ones.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators.laboratory.bench import (
    LabBench,
    TrueCause,
    Truth,
    trial_name,
)
from tests.benchmarks.simulators.laboratory.casts import random_cast
from tests.benchmarks.simulators.laboratory.causes import NAMED, Hidden, Plain
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import (
    CHECK,
    FINE,
    LIKELY,
    ROUGH,
    Cast,
    Laboratory,
    Scene,
    at_tip,
    unexplained,
)
from tests.benchmarks.simulators.laboratory.version import (
    NONE,
    OUTSIDE,
    PAIR,
    SINGLE,
    TRIPLE,
    VERSIONS,
    Version,
)

# as conf/arm/paper.yaml had it: a seed means the same bench whatever the settings
ARM = Arm(
    links=(0.25, 0.20, 0.135),
    base=(0.2, 0.2),
    lowest=(-1.5708, -2.2689, -2.2689),
    highest=(3.1416, 2.2689, 2.2689),
    speed=(20.66, 20.66, 20.66),
    acceleration=(300.0, 300.0, 300.0),
    hand_speed=21.8,
    tick=0.005,
)
SIZES = (3e-3, 12e-3)  # [m] at the tip
LEAST = 2.5e-3  # [m] of what is then unexplained: above the tolerance of 2 mm
# [m] that the likeliest single effect of the library leaves of an outside cause
LEFT = 4e-3
SPEEDS = (1.2, 4.0)  # of the hand [m/s]
SLOWER = 0.85  # of the fastest cast that is tried, after one that is chaotic
FAST = (5.0, 8.0)  # [m/s] of casts that are likely to be chaotic
FEWEST, MOST, SPARE = 4, 6, 1  # trials
KNOWN = 1 / 3  # of the noise: how well the tip of a good trial is known
CHAOTIC_BENCHES = 0.2  # share of the benches that keep a chaotic trial
# [m] by which a chaotic trial may be unknown: beyond, nobody would have taken it for a
# cast
MOST_CHAOTIC = 0.05
LADDER = np.geomspace(0.01, 1.0, 5)  # shares of a cause among which its size is sought
PATIENCE = 25  # redraws, before another cause has its turn
PROBED = 0.05  # share of a library's cause by which its direction is found


class Redraw(Exception):  # noqa: N818 - nothing has gone wrong
    """Raised where this string, these casts or this cause do not make the bench that is
    wanted.
    """


def draw(
    name: str,
    laboratory: Laboratory,
    seed: int,
    kind: str | None = None,
    version: int | None = None,
) -> LabBench:
    """The bench of a seed in the laboratory of that name. kind: if it is not to be the
    seed's own. version: the latest, if none is given.
    """
    version = version or max(VERSIONS[name])
    own = VERSIONS[name][version]
    kind = kind or own.kind(seed)
    rng = np.random.default_rng([version, seed, zlib.crc32(f"{name} {kind}".encode())])
    tried = 0
    while True:
        try:
            return _drawn(name, laboratory, seed, kind, version, rng, tried // PATIENCE)
        except Redraw:
            tried += 1


def _drawn(
    name: str,
    laboratory: Laboratory,
    seed: int,
    kind: str,
    version: int,
    rng: np.random.Generator,
    further: int,
) -> LabBench:
    """One try. further: how many causes beyond the one whose turn it is, which does not
    suit these strings.
    """
    count = int(rng.integers(FEWEST, MOST + 1))
    scene, unfit = _scene(laboratory, rng, count + SPARE)
    own = VERSIONS[name][version]
    hidden_causes = _hidden(
        kind,
        own,
        own.turn(seed, kind) + further,
        rng,
        scene.performing(scene.casts[:count]),
    )
    values = [thing.at(_share(scene, thing, rng)) for thing in hidden_causes]
    sizes = _sizes(scene, hidden_causes, values)
    left = (
        _left(scene, hidden_causes[0], values[0], own, rng) if kind == OUTSIDE else None
    )
    trials, redrawn = _performed(scene, hidden_causes, values, count, rng)
    good = scene.performing([trial.cast for trial in trials])
    if (
        hidden_causes and hidden_causes[0].only is None
    ):  # once more: what acted in a trial that was redrawn is not there
        sizes = _sizes(good, hidden_causes, values)
    points = tuple(
        trial.points + scene.sigma * _noise(rng, trial.points.shape) for trial in trials
    )
    truth = Truth(
        laboratory=name,
        version=version,
        seed=seed,
        kind=kind,
        causes=tuple(
            _true_cause(*each, trials)
            for each in zip(hidden_causes, values, sizes, strict=True)
        ),
        base=scene.rod.in_points(),
        sigma=scene.sigma,
        numerical_m={trial_name(i): trial.error for i, trial in enumerate(trials)},
        chaotic=tuple(
            trial_name(i)
            for i, trial in enumerate(trials)
            if trial.error > KNOWN * scene.sigma
        ),
        redrawn=unfit + redrawn,
        left_m=min(sizes, default=0.0) if left is None else left,
    )
    return LabBench(good, points, bool(rng.integers(2)), truth)


def _scene(
    laboratory: Laboratory, rng: np.random.Generator, count: int
) -> tuple[Scene, int]:
    """A string, a camera and casts that two rough meshes agree about; and how many
    others they did not.
    """
    length, sigma = (
        float(rng.uniform(0.25, 0.35)),
        float(np.exp(rng.uniform(*np.log([4e-4, 1.2e-3])))),
    )
    s = np.linspace(rng.uniform(0.08, 0.2), 1.0, int(rng.integers(12, 21))) * length
    scene = Scene(laboratory, ARM, _camera(rng), _rod(rng, length), (), s, sigma)
    casts: list[Cast] = []
    slowest, fastest = SPEEDS
    for tried in range(8 * count):
        cast = random_cast(
            ARM,
            rng,
            scene.camera.fps,
            float(np.exp(rng.uniform(*np.log([slowest, fastest])))),
        )
        rough, finer = (scene.measured(cast, {}, level) for level in (ROUGH, LIKELY))
        if _apart(rough, finer) < laboratory.likely:
            casts.append(cast)
        else:
            fastest = max(SLOWER * fastest, slowest)
        if len(casts) == count:
            return scene.performing(casts), tried + 1 - count
    raise Redraw


def _rod(rng: np.random.Generator, length: float) -> Rod:
    """A string between the paper's B and C, and stiffer; drawn by the paper's
    parameters, per mass point at n = 10.
    """

    def about(value: float, factor: float) -> float:
        return float(value * factor ** rng.uniform(-1, 1))

    bending = float(np.exp(rng.uniform(*np.log([1.0, 40.0]))))
    return Rod.of_points(
        length,
        axial_stiffness=about(6e5, 1.4),
        axial_damping=about(30.0, 2.0),
        bending_stiffness=bending,
        bending_damping=about(2.2e-3 * np.sqrt(bending), 1.5),
        linear_drag=about(0.3, 1.8),
        quadratic_drag=about(0.2, 1.8),
        grasp_stiffness=min(about(0.9 * bending**0.7, 1.4), 4.5),
        grasp_damping=about(5e-3, 1.8),
    )


def _camera(rng: np.random.Generator) -> Camera:
    """One that sees all that arm and string can reach, from somewhat aside."""
    width = int(rng.choice([640, 1024, 1280]))
    scale = float(width / rng.uniform(1.9, 2.2))
    centre = rng.uniform(0.35, 0.6), rng.uniform(0.3, 0.5)  # [m]
    origin = (width / 2 - scale * centre[0], width / 2 + scale * centre[1])
    return Camera(
        width,
        width,
        scale,
        (float(origin[0]), float(origin[1])),
        fps=float(rng.choice([100, 125, 200, 240])),
    )


def _hidden(
    kind: str, version: Version, turn: int, rng: np.random.Generator, scene: Scene
) -> list[Hidden]:
    """Causes in circumstances of this scene's trials; singles and outside ones in turn."""
    alone = {NONE: (), SINGLE: version.single, OUTSIDE: version.outside}
    if kind in alone:
        names = [alone[kind][turn % len(alone[kind])]] if alone[kind] else []
    else:
        names = list(
            rng.choice(version.together, {PAIR: 2, TRIPLE: 3}[kind], replace=False)
        )
    plain = _plain(scene)
    hidden_causes = [
        thing for name in names if (thing := NAMED[name].hidden(rng, plain)) is not None
    ]
    if len(hidden_causes) < len(names):
        raise Redraw
    return hidden_causes


def _plain(scene: Scene) -> Plain:
    """The trials without any cause."""
    whole = Scene(
        scene.laboratory,
        scene.arm,
        scene.camera,
        scene.rod,
        scene.casts,
        np.linspace(0, scene.rod.length, 13),
        0,
    )
    hands = tuple(scene.path(cast, {}).at(cast.fine)[:, :2] for cast in scene.casts)
    return Plain(
        scene.rod,
        tuple(cast.frames for cast in scene.casts),
        tuple(whole.seen({}, ROUGH)),
        hands,
    )


def _field(scene: Scene, values: dict[str, float], only: int | None) -> np.ndarray:
    """Points as measured without noise on the rough mesh, (N, S, 2) [m]. Raises Redraw
    where the string is lost.
    """
    field = np.concatenate(scene.seen(values, ROUGH, only))
    if not np.isfinite(field).all():
        raise Redraw
    return field


def _share(scene: Scene, thing: Hidden, rng: np.random.Generator) -> float:
    """The share of a cause at which it moves the tip by a drawn amount beyond what the
    base explains.
    """
    wanted = thing.cause.larger * float(np.exp(rng.uniform(*np.log(SIZES))))
    plain, slopes = _field(scene, {}, None), scene.slopes
    sizes = [0.0]
    for share in LADDER:
        sizes.append(
            at_tip(
                unexplained(_field(scene, thing.at(share), thing.only) - plain, slopes)
            )
        )
        if sizes[-1] > wanted:
            break
    if sizes[-1] < LEAST:
        raise Redraw
    shares = np.array([0.0, *LADDER])[: len(sizes)]
    return float(np.interp(wanted, sizes[-2:], shares[-2:]))


def _sizes(
    scene: Scene, hidden_causes: Sequence[Hidden], values: Sequence[dict[str, float]]
) -> list[float]:
    """How far each cause moves the tip beyond what the base and the other causes
    explain [m].
    """
    only = hidden_causes[0].only if hidden_causes else None
    full = _field(scene, _merged(values), only)
    alone = [
        full - _field(scene, _merged([v for v in values if v is not own]), only)
        for own in values
    ]
    sizes = []
    for i, change in enumerate(alone):
        others = [field for j, field in enumerate(alone) if j != i]
        sizes.append(
            at_tip(
                unexplained(
                    change, np.concatenate([scene.slopes, *(f[None] for f in others)])
                )
            )
        )
    if min(sizes, default=LEAST) < LEAST:
        raise Redraw
    return sizes


def _left(
    scene: Scene,
    thing: Hidden,
    values: dict[str, float],
    version: Version,
    rng: np.random.Generator,
) -> float:
    """Root mean square at the tip [m] that the likeliest single effect of the library
    leaves of an outside cause, linearised.
    """
    now, plain = _field(scene, {}, None), _plain(scene)
    change = _field(scene, values, thing.only) - now
    left = [at_tip(unexplained(change, scene.slopes))]
    for name in version.together:
        ways = [
            hidden
            for _ in range(NAMED[name].ways)
            if (hidden := NAMED[name].hidden(rng, plain)) is not None
        ]
        moved = [_field(scene, way.at(PROBED), None) - now for way in ways]
        left.append(
            at_tip(
                unexplained(
                    change,
                    np.concatenate([scene.slopes, *(field[None] for field in moved)]),
                )
            )
        )
    if min(left) < LEFT:
        raise Redraw
    return min(left)


@dataclass(frozen=True)
class Trial:
    """place: of its cast in the scene. points: (F, S, 2) without noise [m]. error: of
    the tip, at most [m].
    """

    cast: Cast
    place: int
    points: np.ndarray
    error: float


def _performed(
    scene: Scene,
    hidden_causes: Sequence[Hidden],
    values: Sequence[dict[str, float]],
    count: int,
    rng: np.random.Generator,
) -> tuple[list[Trial], int]:
    """Good trials, as many as are wanted or nearly, on some benches with a chaotic one
    among them; how many others were unfit.
    """
    only, merged = hidden_causes[0].only if hidden_causes else None, _merged(values)
    good: list[Trial] = []
    bad: list[Trial] = []
    for place, cast in enumerate(scene.casts):
        trial = _trial(scene, cast, place, merged if only in (None, place) else {})
        (good if trial.error < KNOWN * scene.sigma else bad).append(trial)
        if len(good) == count:
            break
    if len(good) < FEWEST or (
        only is not None and only not in [trial.place for trial in good]
    ):
        raise Redraw
    if rng.uniform() >= CHAOTIC_BENCHES:
        return good, len(bad)
    for place in range(len(scene.casts), len(scene.casts) + 4 * (only is None)):
        cast = random_cast(scene.arm, rng, scene.camera.fps, float(rng.uniform(*FAST)))
        bad.append(_trial(scene, cast, place, merged))
        if 2 * scene.sigma < bad[-1].error < MOST_CHAOTIC:
            at = int(rng.integers(len(good)))
            good[at : at + (len(good) > FEWEST)] = [bad.pop()]
            break
    return good, len(bad)


def _trial(scene: Scene, cast: Cast, place: int, values: dict[str, float]) -> Trial:
    """A cast as finely as it is measured, and how far a coarser simulation is off."""
    fine, check = (scene.measured(cast, values, level) for level in (FINE, CHECK))
    return Trial(cast, place, fine, _apart(fine, check))


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """The largest distance of the tip between two simulations (F, S, 2) [m]; infinite
    where one is lost.
    """
    apart = np.linalg.norm((one - other)[:, -1], axis=-1)
    return float(np.where(np.isfinite(apart), apart, np.inf).max())


def _true_cause(
    thing: Hidden, values: dict[str, float], size: float, trials: Sequence[Trial]
) -> TrueCause:
    """A cause as the ground truth lists it."""
    place = (
        [trial.place for trial in trials].index(thing.only)
        if thing.only is not None
        else None
    )
    only = None if place is None else trial_name(place)
    cause = thing.cause
    return TrueCause(
        cause.name, cause.library, values, cause.comparable(values), size, only
    )


def _merged(values: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: value for each in values for name, value in each.items()}


def _noise(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of unit variance, correlated with the neighbour along the string and with
    the frame before. shape: (F, S, 2).
    """
    along, before = rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.4)
    white = rng.standard_normal((shape[0], shape[1] + 1, shape[2]))
    field = (white[:, 1:] + along * white[:, :-1]) / np.hypot(1.0, along)
    for k in range(1, len(field)):
        field[k] = before * field[k - 1] + np.sqrt(1 - before**2) * field[k]
    return np.asarray(field)
