"""How soon, and how surely, eight parameters are found from four casts: `python3
tasks.py bench estimates`.

Every set of `estimation_sets` is estimated by each contender in turn, in the processor
time of one thread. Five minutes of a core. Leaves a row for each set and contender in
`estimates.parquet`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from unittest.mock import patch

import numba
import numpy as np
import pandas as pd
from scipy.optimize import least_squares as trust_region

from stringcast.data.schema import Column, Table
from stringcast.stages.estimate import least_squares
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference import batch
from stringcast.stages.inference.huber import huber_loss
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import refine_solution, screen_candidates
from stringcast.stages.inference.solver import FIRST_DIFFERENCE, forward_differences
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model import model as forward_model
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents, parameter_values
from tests.speed.estimation_sets import MATCHED, CastSet, configured, drawn, model
from tests.speed.measures import Row, seen

SETS = 32
NEAR = 5.0  # of the log-likelihood below its maximum: nearer is the right minimum
# [s] of one core, [mm] of a cast that was not fitted, share
GOALS = {"seconds": 2.0, "held_out": 0.2, "right": 0.95}
ESTIMATES = Table(
    "estimates",
    "a row for each set of casts and each way to estimate eight parameters from it",
    (
        Column("contender", "", "way", "text"),
        Column("seed", "1", "of the set", "int"),
        Column("string", "", "of the virtual lab, or drawn", "text"),
        Column(
            "matched",
            "",
            "what was measured is a chain like the one that is fitted with 20 points",
            "bool",
        ),
        Column("seconds", "s", "processor time of one thread"),
        Column("simulations", "1", "strings simulated, each in one trial", "int"),
        Column("simulated", "s", "their time in all"),
        Column(
            "held_out",
            "m",
            "root mean square of a cast without noise that was not fitted",
        ),
        Column("least", "m", "the same from the minimum beside the truth"),
        Column(
            "above",
            "1",
            "how far below its maximum beside the truth the log-likelihood is",
        ),
    ),
)


@dataclass(frozen=True)
class Contender:
    """A way to find the values (P,) of a model's parameters, and sets that it is asked
    for: those from a chain like its own, the others, or both.
    """

    model: Model
    way: Callable[[Model, CastSet], np.ndarray]
    matched: tuple[bool, ...] = (True, False)


def ours(fitted: Model, given: CastSet) -> np.ndarray:
    """The estimate stage as it is configured, E and intervals included."""
    settings = configured("estimate/least_squares.yaml")
    settings["matching"] = Matching(**settings["matching"])
    found = least_squares.estimate(
        fitted, given.trials, None, seed=0, manipulation=1, **settings
    )
    return fitted.values(found.values())


def scipy(fitted: Model, given: CastSet) -> np.ndarray:
    """SciPy's trust region on the same residuals, from the best of as many random
    strings; slopes in our batches.
    """
    settings = configured("estimate/least_squares.yaml")
    likelihood = likelihood_of(fitted, given)
    tried = np.random.default_rng([0, 1]).uniform(
        0, 1, (settings["screening"], len(fitted.parameters))
    )
    start = np.clip(screen_candidates(likelihood, tried, 1)[0], 1e-6, 1 - 1e-6)

    def residual(chi: np.ndarray) -> np.ndarray:
        return likelihood.residuals(chi[None])[0]

    def jacobian(chi: np.ndarray) -> np.ndarray:
        return forward_differences(
            likelihood,
            chi[None],
            residual(chi)[None],
            np.full((1, len(chi)), FIRST_DIFFERENCE),
        )[0].T

    found = trust_region(
        residual, start, jacobian, bounds=(0, 1), x_scale="jac", max_nfev=100
    )
    return parameter_values(fitted.parameters, found.x)


CONTENDERS = {
    "least_squares": Contender(model(), ours),
    "least_squares, 39 points": Contender(model(39, 5e-4), ours, (False,)),
    "SciPy's trust region, our simulation": Contender(model(), scipy),
}


def likelihood_of(fitted: Model, given: CastSet) -> Likelihood:
    """Of the set's trials."""
    return Likelihood(
        TrialData(tuple(prepare_trial(fitted, trial) for trial in given.trials)), fitted
    )


@contextmanager
def counted() -> Iterator[list[tuple[int, float]]]:
    """How many strings are simulated, and for how long each [s], call by call."""
    calls: list[tuple[int, float]] = []

    def noted(simulate, string, hand, values, times, *more):  # type: ignore[no-untyped-def]
        calls.append((len(values), float(np.max(times) - hand.start)))
        return simulate(string, hand, values, times, *more)

    with ExitStack() as stack:
        for module in (batch, forward_model):
            stack.enter_context(
                patch.object(module, "simulate", partial(noted, module.simulate))
            )
        yield calls


def row(name: str, seed: int) -> dict[str, object]:
    """One contender on one set."""
    given, fitted = drawn(seed), CONTENDERS[name].model
    with counted() as calls:
        begun = time.thread_time()
        found = CONTENDERS[name].way(fitted, given)
        seconds = time.thread_time() - begun
    likelihood, held_out = (
        likelihood_of(fitted, given),
        prepare_trial(fitted, given.held_out),
    )
    here, truth = (
        parameter_exponents(fitted.parameters, values)[None]
        for values in (found, given.truth)
    )
    judge, best = refine_solution(likelihood, truth[0])
    least, left = (
        huber_loss(judge.residuals(chi), judge.limit)[0] for chi in (best[None], here)
    )
    above = 0.5 * judge.residuals(here).size * np.log(left / least)
    off = [
        np.sqrt(held_out.mean_square_distances(values)[0])
        for values in (found, parameter_values(fitted.parameters, best))
    ]
    counts = {
        "simulations": sum(n for n, _ in calls),
        "simulated": sum(n * t for n, t in calls),
    }
    about = {
        "contender": name,
        "seed": seed,
        "string": given.name,
        "matched": seed < MATCHED,
    }
    return (
        about
        | counts
        | {"seconds": seconds, "held_out": off[0], "least": off[1], "above": above}
    )


def estimates(sets: int = SETS) -> pd.DataFrame:
    """Table ESTIMATES of the first sets, by all contenders in turn; the first of each,
    which may compile, is made twice.
    """
    numba.set_num_threads(1)
    for name in CONTENDERS:
        row(name, 0)
    asked = [
        (n, s)
        for s in range(sets)
        for n, c in CONTENDERS.items()
        if (s < MATCHED) in c.matched
    ]
    return ESTIMATES.check(pd.DataFrame([row(name, seed) for name, seed in asked]))


def summary(table: pd.DataFrame) -> list[Row]:
    """Table ESTIMATES in a few rows of the bench's: of each contender, on matched sets
    and on the others.
    """
    rows = []
    for (name, matched), some in table.groupby(["contender", "matched"], sort=False):
        what = f"eight parameters from four casts of a {'like' if matched else 'finer'} chain"
        right = float(np.mean(some["above"] < NEAR))
        rows += [
            seen(what, name, some["seconds"], "s", threads=1, at_most=GOALS["seconds"]),
            seen(
                what,
                f"{name}: held out",
                1e3 * some["held_out"],
                "mm",
                at_most=GOALS["held_out"],
            ),
            Row(
                what,
                f"{name}: right minimum",
                right,
                f"of {len(some)}",
                at_least=GOALS["right"],
            ),
            seen(what, f"{name}: simulations", some["simulations"].astype(float), "1"),
        ]
    return rows
