"""From observations to evidence: noise floor, outliers, mass points enough, and the base model fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.data.artifacts import Observation
from stringcast.stages.common import Progress
from stringcast.stages.diagnose.beginning import begun, doubted_beginnings, move_at_first
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted, ranked
from stringcast.stages.diagnose.noise import cleaned, estimated, scattered
from stringcast.stages.diagnose.ranges import widened, with_ranges
from stringcast.stages.diagnose.resolve import SEGMENTS, refined
from stringcast.stages.diagnose.search import searched
from stringcast.stages.diagnose.single_effects.prepared import awake
from stringcast.stages.diagnose.single_effects.proposals import candidates
from stringcast.stages.diagnose.theory import Theory, whole
from stringcast.stages.inference.forward import Case, case
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.implicit import ImplicitLeapfrog
from stringcast.stages.model.model import Model

GUESS = 1e-3  # [m] of noise before anything is known
TOLD_WRONG = 1.3  # times the noise that the data's author states: then the data are believed
STEP = 1e-3  # [s] of the implicit integrator: at 20 points its error is a hundredth of theirs
LONGER = (4e-3, 2e-3)  # [s] that are tried in its place
UNTOLD = 0.2  # noises by which longer steps may move a point
STEPS = 20
TAKEN_BACK = 0.02  # share of the points: so many more that are no outliers are another ground
SETTLINGS = 2  # of the states in which trials begin moving


@dataclass(frozen=True)
class Raw:
    """Evidence whose noise is not known yet. told: whether its sigma is its author's, else it is a guess."""

    evidence: Evidence
    told: bool

    def cleaned(self, fit: Fit) -> tuple[Evidence, int]:
        """With the noise as a fit leaves it, without outliers, and how many these were."""
        residual = self.evidence.residuals(fit.theory.model, fit.chi[None])[0]
        noise = estimated(self.evidence, residual)
        factor = noise if not self.told or noise > TOLD_WRONG else 1.0
        evidence, outliers = cleaned(self.evidence.scaled(factor), residual / factor)
        return doubted_beginnings(evidence, fit.theory.model, fit.chi), outliers

    @property
    def points(self) -> int:
        """How many there are."""
        return sum(len(case.s) for case in self.evidence.cases)

    def divided(self, segments: tuple[int, ...]) -> Raw:
        """With other numbers of segments."""
        return replace(self, evidence=replace(self.evidence, segments=segments))


@dataclass(frozen=True)
class Ground:
    """What the diagnosis starts from.

    model: the base model with mass points that do not matter. evidence: with noise and the simulation's own doubt as
    sigma; undoubted: with noise alone. base: the base model at its best, of all effects absent. configured: the same
    as it is configured, with its own number of mass points. raw: the evidence before its noise was known. outliers,
    resting: points left out, for they are far from those before and after, or of a string that hangs still at its
    trial's end.
    """

    model: Model
    evidence: Evidence
    undoubted: Evidence
    base: Fit
    configured: Fit
    raw: Raw
    outliers: int = 0
    resting: int = 0

    @property
    def floor(self) -> np.ndarray:
        """Noise of each residual [m], (N,)."""
        return self.undoubted.sigma

    @property
    def scattered(self) -> list[str]:
        """Names of trials whose points are nowhere near those just before and after."""
        return scattered(self.undoubted, self.base.residual * self.evidence.sigma / self.floor)

    @cached_property
    def beside_noise(self) -> float:
        """Mean square of what the base model leaves over the noise alone, as the configured one is fitted."""
        return fitted(self.undoubted, [self.base.theory], [self.base.chi], STEPS)[0].mean_square


def prepared(
    model: Model,
    observations: Sequence[Observation],
    library: Mapping[str, type[Effect]],
    rng: np.random.Generator,
    starts: int,
    progress: Progress,
) -> Ground:
    """Evidence and base model. Raises DataError where a trial cannot be used."""
    told = all("sigma" in o.points for o in observations)
    whole_trials = [_known(case(resolved(model), o), told) for o in observations]
    evidence = Evidence(tuple(awake(ready) for ready in whole_trials), SEGMENTS[0])
    resting = sum(len(ready.s) for ready in whole_trials) - sum(len(ready.s) for ready in evidence.cases)
    found = searched(evidence, plain_theory(resolved(model)), rng, starts, progress)
    found = widened(evidence, found)
    model = with_ranges(model, found[0].theory.model.string.ranges)
    evidence, found = settled_starts(evidence, found)
    theory, best = found[0].theory, found[0]
    raw = Raw(evidence, told)
    evidence, outliers = raw.cleaned(best)
    theory = eased(replace(evidence, unsure=()), theory, best.chi)
    plain = replace(evidence, segments=(model.string.points - 1,))
    named = [theory.named(fit.chi) for fit in found]
    configured = widened(plain, [_best(plain, plain_theory(model), named)])[0]
    doubted = refined(evidence, theory, best.chi)
    base = _best(doubted, whole(theory.model, candidates(theory.model, library, evidence.cases), evidence), named)
    undoubted = replace(evidence, segments=doubted.segments)
    return Ground(theory.model, doubted, undoubted, base, configured, raw, outliers, resting)


def literal(ground: Ground, library: Mapping[str, type[Effect]], points: int) -> Ground:
    """The ground with so many equal mass points, which stand for data that are made of such; the steps in time are not
    theirs, but exact enough. What is noise is told anew, since this is nearer to the data."""
    nearest = _of_points(ground, points)
    model, segments = nearest.theory.model, (points - 1,)
    evidence, outliers = ground.raw.divided(segments).cleaned(nearest)
    theory = whole(model, candidates(model, library, evidence.cases), evidence)
    base = _best(evidence, theory, [nearest.theory.named(nearest.chi)])
    known = base if points == ground.configured.theory.model.string.points else _as_configured(ground, evidence)
    return replace(
        ground, model=model, evidence=evidence, undoubted=evidence, base=base, configured=known, outliers=outliers
    )


def cleaned_anew(ground: Ground, segments: tuple[int, ...], plain: Fit, fit: Fit) -> Ground | None:
    """The ground with noise and outliers told where causes put the string; None where that hardly differs.

    Beside a model that lacks a cause, points that change fast look like outliers. segments: with which the causes were
    fitted. plain: a fit without them.
    """
    raw = ground.raw.divided(segments)
    raw = replace(raw, evidence=begun(raw.evidence, fit.theory.model, fit.chi))
    evidence, outliers = raw.cleaned(fit)
    if ground.outliers - outliers < TAKEN_BACK * raw.points:
        return None
    doubted = refined(evidence, fit.theory, fit.chi)
    base = _best(doubted, plain.theory, [plain.theory.named(plain.chi)])
    undoubted, configured = replace(evidence, segments=doubted.segments), _as_configured(ground, evidence)
    return Ground(ground.model, doubted, undoubted, base, configured, raw, outliers, ground.resting)


def _as_configured(ground: Ground, evidence: Evidence) -> Fit:
    """The base model as it is configured, fitted to other evidence."""
    known = ground.configured.theory
    own = replace(evidence, segments=(known.model.string.points - 1,))
    return _best(own, known, [known.named(ground.configured.chi)])


def _of_points(ground: Ground, points: int) -> Fit:
    """The base model at its best with so many equal points."""
    plain, fine = ground.configured.theory, ground.model.string
    string = replace(plain.model.string, integrator=fine.integrator, largest_step=fine.largest_step, points=points)
    theory = replace(plain, model=replace(plain.model, string=string))
    evidence = replace(ground.undoubted, segments=(points - 1,))
    named = [fit.theory.named(fit.chi) for fit in (ground.configured, ground.base)]
    return widened(evidence, [_best(evidence, theory, named)])[0]


def plain_theory(model: Model) -> Theory:
    """The base model alone."""
    return Theory(model, (), model.names)


def settled_starts(evidence: Evidence, found: Sequence[Fit]) -> tuple[Evidence, list[Fit]]:
    """With the states in which trials begin moving corrected by how they go on, and the fits to that."""
    fits = list(found)
    for _ in range(SETTLINGS if move_at_first(evidence) else 0):
        evidence = begun(evidence, fits[0].theory.model, fits[0].chi)
        fits = ranked(fitted(evidence, [fit.theory for fit in fits], [fit.chi for fit in fits], STEPS))
    return evidence, fits


def eased(evidence: Evidence, theory: Theory, chi: np.ndarray) -> Theory:
    """The theory with the longest steps that nobody could tell from its own: slow strings ask for fewer."""
    exact = evidence.residuals(theory.model, chi[None])
    for step in LONGER:
        model = replace(theory.model, string=replace(theory.model.string, largest_step=step))
        if np.abs(evidence.residuals(model, chi[None]) - exact).max() < UNTOLD:
            return replace(theory, model=model)
    return theory


def _known(ready: Case, told: bool) -> Case:
    return ready if told else replace(ready, sigma=np.full(len(ready.s), GUESS))


def resolved(model: Model) -> Model:
    """With half cells at the ends and implicit steps, so that what mass points do is of second order."""
    string = replace(model.string, tip_cell=0.5, grasp_cell=0.5, integrator=ImplicitLeapfrog(), largest_step=STEP)
    return replace(model, string=string)


def _best(evidence: Evidence, theory: Theory, named: Sequence[Mapping[str, float]]) -> Fit:
    """A theory from exponents known by name, the best of several."""
    fits = fitted(evidence, [theory] * len(named), [theory.carried(known) for known in named], STEPS)
    return ranked(fits)[0]
