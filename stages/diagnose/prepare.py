"""From observations to evidence: noise floor, outliers, mass points enough, and the base model fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from data.artifacts import Observation
from stages.diagnose.evidence import Evidence
from stages.diagnose.fit import Fit, fitted
from stages.diagnose.noise import cleaned, estimated
from stages.diagnose.search import searched
from stages.diagnose.theory import Theory, candidates, whole
from stages.estimate.forward import Case, case
from stages.model.effect import Effect
from stages.model.implicit import ImplicitLeapfrog
from stages.model.model import Model

SEGMENTS = ((10, 14), (14, 20), (20, 28), (28, 40))
GUESS = 1e-3  # [m] of noise before anything is known
TOLD_WRONG = 1.3  # times the noise that the data's author states: then the data are believed
DOUBTFUL = 1.5  # times the noise: a point whose simulation is as uncertain as that says less
MANY = 0.35  # share of doubtful points from which more mass points are taken
STEP = 1e-3  # [s] of the implicit integrator: at 20 points its error is a hundredth of theirs
COARSE_WINS = 0.8  # of the mean square: then the data were made with the configured number of points
STEPS = 20


@dataclass(frozen=True)
class Ground:
    """What the diagnosis starts from.

    model: the base model with mass points that do not matter. evidence: with noise and the simulation's own doubt as
    sigma. floor: noise of each point alone [m], (N,), two for each point. base: the base model at its best, of all
    effects absent. configured: the same as it is configured, with its own number of mass points; plain: evidence for
    that. outliers: points left out. told: the data say how noisy they are.
    """

    model: Model
    evidence: Evidence
    plain: Evidence
    floor: np.ndarray
    base: Fit
    configured: Fit
    outliers: int
    told: bool


def prepared(
    model: Model,
    observations: Sequence[Observation],
    library: Mapping[str, type[Effect]],
    rng: np.random.Generator,
    starts: int,
    progress: Callable[[float], object],
) -> Ground:
    """Evidence and base model. Raises DataError where a trial cannot be used."""
    fine = resolved(model)
    told = all("sigma" in o.points for o in observations)
    evidence = Evidence(tuple(_known(case(fine, o), told) for o in observations), SEGMENTS[0])
    theory = Theory(fine, (), fine.names)
    found = searched(evidence, theory, rng, starts, progress)
    noise = estimated(evidence, found[0].residual)
    evidence = evidence.scaled(noise if not told or noise > TOLD_WRONG else 1.0)
    evidence, outliers = cleaned(evidence, evidence.residuals(fine, found[0].chi[None])[0])
    plain = replace(evidence, segments=(model.string.points - 1,))
    named = [theory.named(fit.chi) for fit in found[:2]]
    configured = _configured(plain, model, named)
    floor = evidence.sigma
    doubted = refined(evidence, theory, found[0].chi)
    base = _absent(doubted, whole(fine, candidates(fine, library, evidence)), named)
    return Ground(fine, doubted, plain, floor, base, configured, outliers, told)


def _known(ready: Case, told: bool) -> Case:
    return ready if told else replace(ready, sigma=np.full(len(ready.s), GUESS))


def resolved(model: Model) -> Model:
    """With half cells at the ends and implicit steps, so that what mass points do is of second order."""
    string = replace(model.string, tip_cell=0.5, grasp_cell=0.5, integrator=ImplicitLeapfrog(), largest_step=STEP)
    return replace(model, string=string)


def refined(evidence: Evidence, theory: Theory, chi: np.ndarray) -> Evidence:
    """With the fewest mass points whose own error does not matter for most of the data, and their doubt."""
    for few, more in pairwise(SEGMENTS):
        fitted_here = fitted(replace(evidence, segments=few), [theory], [chi], STEPS)[0]
        doubted = replace(evidence, segments=few).doubted(theory.model, fitted_here.chi, more)
        if np.mean(doubted.sigma > DOUBTFUL * evidence.sigma) < MANY:
            break
    return doubted


def finer(evidence: Evidence) -> tuple[int, ...]:
    """The next numbers of segments."""
    following: dict[tuple[int, ...], tuple[int, int]] = dict(pairwise(SEGMENTS))
    return following.get(evidence.segments, SEGMENTS[-1])


def _configured(plain: Evidence, model: Model, named: Sequence[dict[str, float]]) -> Fit:
    """The base model as it is configured, from where the finer one is."""
    theory = Theory(model, (), model.names)
    fits = fitted(plain, [theory] * len(named), [theory.carried(known) for known in named], STEPS)
    return min(fits, key=lambda fit: fit.cost)


def _absent(evidence: Evidence, theory: Theory, named: Sequence[dict[str, float]]) -> Fit:
    """The base model with all effects at hand and absent."""
    fits = fitted(evidence, [theory] * len(named), [theory.carried(known) for known in named], STEPS)
    return min(fits, key=lambda fit: fit.cost)
