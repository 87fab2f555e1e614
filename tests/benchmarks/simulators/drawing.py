"""Draw a synthetic dataset from a seed: string, casts, hidden causes and their sizes.

A cause displaces the tip by a drawn number of millimetres, root mean square over all
frames, beyond what base parameters and the other causes explain, linearised about the
truth. Every trial is simulated twice, with two meshes and steps: a cast whose numerical
error may exceed a third of the noise is redrawn. Some datasets keep one such trial.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from tests.benchmarks.simulators.causes import Cause, HiddenCause, PlainTrials
from tests.benchmarks.simulators.dataset import (
    GroundTruth,
    SyntheticDataset,
    TrueCause,
    trial_name,
)
from tests.benchmarks.simulators.motions import Cast, random_cast
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import (
    Fidelity,
    Scene,
    Simulator,
    largest_tip_distance,
    remove_projection,
    tip_rms,
)

ROOT = Path(__file__).resolve().parents[3]
NONE, EFFECT, PAIR, TRIPLE, OUTSIDE = "none", "effect", "pair", "triple", "outside"
MIXED = "mixed"  # causes of the library and one outside it, with common nuisances
KINDS = (NONE, EFFECT, PAIR, TRIPLE, OUTSIDE, MIXED)
# Kinds of consecutive seeds: any ten are balanced. A mixed dataset is drawn on demand.
CYCLE = (
    EFFECT, NONE, OUTSIDE, PAIR, EFFECT, OUTSIDE, NONE, EFFECT, TRIPLE, EFFECT
)  # fmt: skip
SIZE_RANGE_M = (3e-3, 12e-3)  # rms displacement of the tip
MIN_SIZE_M = 2.5e-3  # above the diagnosis' tolerance of 2 mm
MIN_UNEXPLAINED_M = 4e-3  # left of an outside cause by the likeliest library effect
MIN_UNEXPLAINED_IN_MIXTURE_M = 2.5e-3  # the same, beside a cause of the library
TWO_KNOWN_SHARE = 0.3  # share of mixtures with two causes of the library
OUTSIDE_OVER_KNOWN = (0.2, 5.0)  # size of the outside cause of a mixture
MAX_OUTSIDE_SIZE_M = 25e-3
NUISANCE_SHARE = 0.5  # share of mixtures that have each nuisance
MAX_CLOCK_ERROR_S = 3e-3
MAX_ARC_LENGTH_ERROR = 0.005
HAND_SPEED_RANGE = (1.2, 4.0)  # [m/s]
SLOWDOWN = 0.85  # factor of the fastest speed after a chaotic cast
FAST_HAND_SPEED_RANGE = (5.0, 8.0)  # [m/s], of casts that are likely to be chaotic
MIN_TRIALS, MAX_TRIALS, SPARE_TRIALS = 4, 6, 1
MAX_NUMERICAL_ERROR = 1 / 3  # share of the noise, at the tip of a good trial
CHAOTIC_SHARE = 0.2  # share of the datasets that keep a chaotic trial
MIN_CHAOTIC_ERROR = 2.0  # in noise sigmas
MAX_CHAOTIC_ERROR_M = 0.05  # a larger error makes the trial unlike a cast
# shares of a cause that bracket the drawn size
SIZE_LADDER = np.geomspace(0.01, 1.0, 5)
CIRCUMSTANCES_TRIED = 5  # tried for a cause that hardly moves the tip
REDRAWS_PER_CAUSE = 25  # redraws before another cause is tried
PROBED_SHARE = 0.05  # share of a library cause that gives its direction


class Redraw(Exception):  # noqa: N818 - nothing has gone wrong
    """Raised where string, casts or causes do not make the dataset that is wanted."""


@dataclass(frozen=True)
class Plan:
    """A dataset to draw; `cause_names` are None if the causes are drawn, too.

    `trial_counts` are the fewest and the most trials.
    """

    simulator_name: str
    simulator: Simulator
    seed: int
    kind: str
    cause_names: tuple[str, ...] | None
    trial_counts: tuple[int, int] = (MIN_TRIALS, MAX_TRIALS)

    def draw_causes(self, rng: np.random.Generator, skipped: int) -> list[Cause]:
        """Choose the causes: single ones in turn, several at random.

        `skipped` is the number of causes whose turn it is, but which do not suit.
        """
        causes = {cause.name: cause for cause in self.simulator.causes}
        if self.cause_names is not None:
            return [causes[name] for name in self.cause_names]
        if self.kind == NONE:
            return []
        if self.kind == MIXED:
            return self._draw_mixture(rng, skipped)
        wanted = [c for c in causes.values() if c.outside == (self.kind == OUTSIDE)]
        if self.kind in (EFFECT, OUTSIDE):
            return [wanted[(turn_of(self.seed, self.kind) + skipped) % len(wanted)]]
        count = 2 if self.kind == PAIR else 3
        return [wanted[i] for i in rng.choice(len(wanted), count, replace=False)]

    def _draw_mixture(self, rng: np.random.Generator, skipped: int) -> list[Cause]:
        """Choose one or two causes of the library, and one outside it, the last."""
        known = [cause for cause in self.simulator.causes if not cause.outside]
        first = (self.seed + skipped) % len(known)
        mixture = [known[first]]
        if rng.uniform() < TWO_KNOWN_SHARE:
            other = (first + rng.integers(1, len(known))) % len(known)
            mixture.append(known[other])
        outside = self.simulator.outside_causes_of_mixtures
        mixture.append(outside[rng.integers(len(outside))])
        return mixture


def kind_of(seed: int) -> str:
    """Return the kind of dataset that a seed means."""
    return CYCLE[seed % len(CYCLE)]


def turn_of(seed: int, kind: str) -> int:
    """Return the number of datasets of a kind before that of a seed.

    It is the seed itself if the seed means another kind.
    """
    if kind != kind_of(seed):
        return seed
    cycles, place = divmod(seed, len(CYCLE))
    return cycles * CYCLE.count(kind) + CYCLE[:place].count(kind)


def draw_planned(plan: Plan) -> SyntheticDataset:
    """Draw until string, casts and causes suit one another."""
    words = f"{plan.simulator_name} {plan.kind} {plan.cause_names}"
    rng = np.random.default_rng([plan.seed, zlib.crc32(words.encode())])
    tries = 0
    while True:
        try:
            return _try_to_draw(plan, rng, tries // REDRAWS_PER_CAUSE)
        except Redraw:
            tries += 1


def _try_to_draw(
    plan: Plan, rng: np.random.Generator, skipped: int
) -> SyntheticDataset:
    fewest, most = plan.trial_counts
    count = int(rng.integers(fewest, most + 1))
    scene, unfit = _draw_scene(plan.simulator, rng, count + SPARE_TRIALS)
    causes = plan.draw_causes(rng, skipped)

    trials = plain_trials(scene.with_casts(scene.casts[:count]))
    hidden = []
    settings = []
    size_m = 0.0
    for cause in causes:
        if plan.kind == MIXED and cause.outside:
            size_m = _draw_outside_size(cause, size_m, rng)
        else:
            size_m = draw_size(cause, rng)
        hidden_cause, share = hide_cause(scene, cause, size_m, trials, rng)
        hidden.append(hidden_cause)
        settings.append(hidden_cause.settings(share))
    sizes = _sizes(scene, hidden, settings)
    if plan.kind == MIXED and sizes[-1] > causes[-1].size_factor * MAX_OUTSIDE_SIZE_M:
        raise Redraw
    unexplained = min(sizes, default=0.0)
    if plan.kind in (OUTSIDE, MIXED):
        unexplained = _least_unexplained(scene, hidden[-1], settings[-1], rng)
        needed = MIN_UNEXPLAINED_M
        if plan.kind == MIXED:
            needed = MIN_UNEXPLAINED_IN_MIXTURE_M
        if unexplained < needed:
            raise Redraw
    nuisances: dict[str, float] = {}
    if plan.kind == MIXED:
        nuisances = _draw_nuisances(_merge(settings), rng)

    performed, redrawn = _perform(scene, hidden, settings, nuisances, count, rng)
    kept = scene.with_casts([trial.cast for trial in performed])
    if hidden and not _acts_once(hidden):
        # A cause that acted in a redrawn trial may not show in the others.
        sizes = _sizes(kept, hidden, settings)
    points = []
    for trial in performed:
        noise = correlated_noise(rng, trial.points.shape)
        points.append(trial.points + scene.sigma * noise)

    errors = {trial_name(i): trial.error_m for i, trial in enumerate(performed)}
    limit = MAX_NUMERICAL_ERROR * scene.sigma
    true_causes = []
    for i, hidden_cause in enumerate(hidden):
        true_causes.append(_true_cause(hidden_cause, settings[i], sizes[i], performed))
    truth = GroundTruth(
        simulator=plan.simulator_name,
        seed=plan.seed,
        kind=plan.kind,
        causes=tuple(true_causes),
        base=scene.rod.paper_parameters(),
        sigma=scene.sigma,
        numerical_error_m=errors,
        chaotic=tuple(name for name, error in errors.items() if error > limit),
        redrawn=unfit + redrawn,
        unexplained_m=unexplained,
        nuisances=nuisances,
    )
    return SyntheticDataset(kept, tuple(points), bool(rng.integers(2)), truth)


def configured_arm() -> Arm:
    """Return the paper's arm."""
    block = yaml.safe_load((ROOT / "conf" / "arm" / "paper.yaml").read_text())
    for name, value in block.items():
        if isinstance(value, list):
            block[name] = tuple(value)
    return Arm(**block)


def _draw_scene(
    simulator: Simulator, rng: np.random.Generator, count: int
) -> tuple[Scene, int]:
    """Draw a string, a camera and casts about which two coarse meshes agree.

    The second value is the number of casts about which they did not.
    """
    length = float(rng.uniform(0.25, 0.35))
    sigma = float(np.exp(rng.uniform(*np.log([4e-4, 1.2e-3]))))
    s = np.linspace(rng.uniform(0.08, 0.2), 1.0, int(rng.integers(12, 21))) * length
    camera, rod = draw_camera(rng), draw_rod(rng, length)
    scene = Scene(simulator, configured_arm(), camera, rod, (), s, sigma)
    casts: list[Cast] = []
    slowest, fastest = HAND_SPEED_RANGE
    for tries in range(8 * count):
        speed = float(np.exp(rng.uniform(*np.log([slowest, fastest]))))
        cast = random_cast(scene.arm, rng, camera.fps, speed)
        coarse = scene.observe(cast, {}, Fidelity.SEARCH)
        finer = scene.observe(cast, {}, Fidelity.SCREENING)
        if largest_tip_distance(coarse, finer) < simulator.screening_tolerance:
            casts.append(cast)
        else:
            fastest = max(SLOWDOWN * fastest, slowest)
        if len(casts) == count:
            return scene.with_casts(casts), tries + 1 - count
    raise Redraw


def draw_rod(rng: np.random.Generator, length: float) -> Rod:
    """Draw a string between the paper's B and C, or stiffer."""

    def scatter(value: float, factor: float) -> float:
        return float(value * factor ** rng.uniform(-1, 1))

    bending = float(np.exp(rng.uniform(*np.log([1.0, 40.0]))))
    return Rod.from_paper_parameters(
        length,
        axial_stiffness=scatter(6e5, 1.4),
        axial_damping=scatter(30.0, 2.0),
        bending_stiffness=bending,
        bending_damping=scatter(2.2e-3 * np.sqrt(bending), 1.5),
        linear_drag=scatter(0.3, 1.8),
        quadratic_drag=scatter(0.2, 1.8),
        grasp_stiffness=min(scatter(0.9 * bending**0.7, 1.4), 4.5),
        grasp_damping=scatter(5e-3, 1.8),
    )


def draw_camera(rng: np.random.Generator) -> Camera:
    """Draw a camera that sees all that arm and string can reach."""
    width = int(rng.choice([640, 1024, 1280]))
    px_per_m = float(width / rng.uniform(1.9, 2.2))
    centre_x, centre_y = rng.uniform(0.35, 0.6), rng.uniform(0.3, 0.5)  # [m]
    origin_u = float(width / 2 - px_per_m * centre_x)
    origin_v = float(width / 2 + px_per_m * centre_y)
    fps = float(rng.choice([100, 125, 200, 240]))
    return Camera(width, width, px_per_m, (origin_u, origin_v), fps=fps)


def plain_trials(scene: Scene) -> PlainTrials:
    """Simulate the casts without any cause."""
    whole = replace(scene, s=np.linspace(0, scene.rod.length, 13), sigma=0.0)
    strings = [whole.observe(cast, {}, Fidelity.SEARCH) for cast in scene.casts]
    hands = []
    for cast in scene.casts:
        hands.append(scene.grasp_path(cast, {}).states(cast.fine)[:, :2])
    times = tuple(cast.frames for cast in scene.casts)
    return PlainTrials(scene.rod, times, tuple(strings), tuple(hands))


def _field(scene: Scene, settings: dict[str, float], only: int | None) -> np.ndarray:
    """Return all points on the coarse mesh, or raise Redraw where it diverges."""
    field = scene.observe_all(settings, Fidelity.SEARCH, only)
    if not np.isfinite(field).all():
        raise Redraw
    return field


def _field_of_causes(
    scene: Scene, hidden: Sequence[HiddenCause], settings: Sequence[dict[str, float]]
) -> np.ndarray:
    """Return all points with several causes, each in the casts in which it acts."""
    fields = []
    for place, cast in enumerate(scene.casts):
        active = _active_settings(hidden, settings, place)
        fields.append(scene.observe(cast, active, Fidelity.SEARCH))
    field = np.concatenate(fields)
    if not np.isfinite(field).all():
        raise Redraw
    return field


def _active_settings(
    hidden: Sequence[HiddenCause], settings: Sequence[dict[str, float]], place: int
) -> dict[str, float]:
    """Return the settings of all causes that act in the cast of a place."""
    active = []
    for hidden_cause, of_cause in zip(hidden, settings, strict=True):
        if hidden_cause.only_trial in (None, place):
            active.append(of_cause)
    return _merge(active)


def _acts_once(hidden: Sequence[HiddenCause]) -> bool:
    """Return whether a cause acts in a single trial."""
    return any(hidden_cause.only_trial is not None for hidden_cause in hidden)


def draw_size(cause: Cause, rng: np.random.Generator) -> float:
    """Draw the rms displacement of the tip by a cause [m]."""
    return cause.size_factor * float(np.exp(rng.uniform(*np.log(SIZE_RANGE_M))))


def _draw_outside_size(
    cause: Cause, known_size_m: float, rng: np.random.Generator
) -> float:
    """Draw the size of the outside cause beside a known one [m]."""
    ratio = float(np.exp(rng.uniform(*np.log(OUTSIDE_OVER_KNOWN))))
    size_m = min(max(ratio * known_size_m, MIN_SIZE_M), MAX_OUTSIDE_SIZE_M)
    return cause.size_factor * size_m


def _draw_nuisances(
    settings: dict[str, float], rng: np.random.Generator
) -> dict[str, float]:
    """Draw small errors that every real dataset has, unless a cause sets the same."""
    ranges = {
        "camera.offset": MAX_CLOCK_ERROR_S,
        "camera.length_error": MAX_ARC_LENGTH_ERROR,
    }
    nuisances = {}
    for name, largest in ranges.items():
        value = float(rng.uniform(-largest, largest))
        if rng.uniform() < NUISANCE_SHARE and name not in settings:
            nuisances[name] = value
    return nuisances


def hide_cause(
    scene: Scene,
    cause: Cause,
    wanted: float,
    trials: PlainTrials,
    rng: np.random.Generator,
) -> tuple[HiddenCause, float]:
    """Draw circumstances of a cause, and the share at which it has the wanted size [m].

    The size is what base parameters do not explain.
    """
    plain = _field(scene, {}, None)
    for _ in range(CIRCUMSTANCES_TRIED):
        hidden = cause.hide(rng, trials)
        if hidden is None:
            continue
        sizes = [0.0]
        for share in SIZE_LADDER:
            moved = _field(scene, hidden.settings(share), hidden.only_trial)
            left = remove_projection(moved - plain, scene.base_slopes)
            sizes.append(tip_rms(left))
            if sizes[-1] > wanted:
                break
        if sizes[-1] >= MIN_SIZE_M:
            shares = np.array([0.0, *SIZE_LADDER])[: len(sizes)]
            return hidden, float(np.interp(wanted, sizes[-2:], shares[-2:]))
    raise Redraw


def _sizes(
    scene: Scene, hidden: Sequence[HiddenCause], settings: Sequence[dict[str, float]]
) -> list[float]:
    """Return what base parameters and the other causes leave of each cause [m]."""
    full = _field_of_causes(scene, hidden, settings)
    changes = []
    for i in range(len(settings)):
        other_causes = [other for j, other in enumerate(hidden) if j != i]
        other_settings = [other for j, other in enumerate(settings) if j != i]
        changes.append(full - _field_of_causes(scene, other_causes, other_settings))
    sizes = []
    for i, change in enumerate(changes):
        others = [other[None] for j, other in enumerate(changes) if j != i]
        columns = np.concatenate([scene.base_slopes, *others])
        sizes.append(tip_rms(remove_projection(change, columns)))
    if min(sizes, default=MIN_SIZE_M) < MIN_SIZE_M:
        raise Redraw
    return sizes


def _least_unexplained(
    scene: Scene,
    hidden: HiddenCause,
    settings: dict[str, float],
    rng: np.random.Generator,
) -> float:
    """Return what the likeliest library effect leaves of an outside cause [m]."""
    plain = _field(scene, {}, None)
    change = _field(scene, settings, hidden.only_trial) - plain
    trials = plain_trials(scene)
    least = tip_rms(remove_projection(change, scene.base_slopes))
    for cause in scene.simulator.causes:
        if cause.outside:
            continue
        columns = [scene.base_slopes]
        for _ in range(cause.directions):
            probe = cause.hide(rng, trials)
            if probe is not None:
                moved = _field(scene, probe.settings(PROBED_SHARE), None)
                columns.append((moved - plain)[None])
        left = remove_projection(change, np.concatenate(columns))
        least = min(least, tip_rms(left))
    return least


@dataclass(frozen=True)
class Trial:
    """A simulated trial without noise.

    Parameters
    ----------
    cast : the motion
    place : number of its cast in the scene
    points : (F, S, 2) [m]
    error_m : numerical error of the tip, at most [m]
    """

    cast: Cast
    place: int
    points: np.ndarray
    error_m: float


def _perform(
    scene: Scene,
    hidden: Sequence[HiddenCause],
    settings: Sequence[dict[str, float]],
    nuisances: dict[str, float],
    count: int,
    rng: np.random.Generator,
) -> tuple[list[Trial], int]:
    """Simulate good trials and, in some datasets, a chaotic one among them.

    The second value is the number of trials that were not kept.
    """
    good: list[Trial] = []
    bad: list[Trial] = []
    for place, cast in enumerate(scene.casts):
        active = _active_settings(hidden, settings, place) | nuisances
        trial = _simulate_trial(scene, cast, place, active)
        is_good = trial.error_m < MAX_NUMERICAL_ERROR * scene.sigma
        (good if is_good else bad).append(trial)
        if len(good) == count:
            break
    kept_places = {None, *(trial.place for trial in good)}
    acts_nowhere = not {cause.only_trial for cause in hidden} <= kept_places
    if len(good) < MIN_TRIALS or acts_nowhere:
        raise Redraw
    if _acts_once(hidden) or rng.uniform() >= CHAOTIC_SHARE:
        return good, len(bad)
    for place in range(len(scene.casts), len(scene.casts) + 4):
        speed = float(rng.uniform(*FAST_HAND_SPEED_RANGE))
        cast = random_cast(scene.arm, rng, scene.camera.fps, speed)
        trial = _simulate_trial(scene, cast, place, _merge(settings) | nuisances)
        if MIN_CHAOTIC_ERROR * scene.sigma < trial.error_m < MAX_CHAOTIC_ERROR_M:
            at = int(rng.integers(len(good)))
            replaced = len(good) > MIN_TRIALS
            good[at : at + replaced] = [trial]
            break
        bad.append(trial)
    return good, len(bad)


def _simulate_trial(
    scene: Scene, cast: Cast, place: int, settings: dict[str, float]
) -> Trial:
    """Simulate a cast with the finest mesh, and compare it with a coarser one."""
    final = scene.observe(cast, settings, Fidelity.FINAL)
    check = scene.observe(cast, settings, Fidelity.CHECK)
    return Trial(cast, place, final, largest_tip_distance(final, check))


def _true_cause(
    hidden: HiddenCause,
    settings: dict[str, float],
    size_m: float,
    performed: Sequence[Trial],
) -> TrueCause:
    only_trial = None
    if hidden.only_trial is not None:
        places = [trial.place for trial in performed]
        only_trial = trial_name(places.index(hidden.only_trial))
    cause = hidden.cause
    parameters = cause.parameters(settings)
    return TrueCause(cause.name, cause.alike, settings, parameters, size_m, only_trial)


def _merge(settings: Sequence[dict[str, float]]) -> dict[str, float]:
    merged: dict[str, float] = {}
    for each in settings:
        merged |= each
    return merged


def correlated_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Draw noise of unit variance, correlated along the string and in time.

    `shape` is (F, S, 2). A point shares noise with its neighbour and with the frame
    before.
    """
    along, before = rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.4)
    white = rng.standard_normal((shape[0], shape[1] + 1, shape[2]))
    noise = (white[:, 1:] + along * white[:, :-1]) / np.hypot(1.0, along)
    for k in range(1, len(noise)):
        noise[k] = before * noise[k - 1] + np.sqrt(1 - before**2) * noise[k]
    return np.asarray(noise)
