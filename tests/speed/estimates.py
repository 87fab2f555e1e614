"""How soon, and how surely, eight parameters are found from four casts: `python -m tests.speed.estimates`.

Every set of `estimation_sets` is estimated by each contender in turn, in the processor time of one thread. A minute or
two for each. Leaves --out, a row for each set and contender.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numba
import numpy as np
import pandas as pd
from scipy.optimize import least_squares as trust_region

from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.stages.estimate import least_squares
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference import batch
from stringcast.stages.inference.forward import case
from stringcast.stages.inference.huber import loss
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.search import refined, screened
from stringcast.stages.inference.solver import FIRST, slopes
from stringcast.stages.model import model as forward_model
from stringcast.stages.model.parameter import chi_of, values_of
from tests.speed.estimation_sets import MATCHED, CastSet, configured, drawn, model
from tests.speed.trial import ROOT

SETS = 32
NEAR = 5.0  # of the log-likelihood below its maximum: nearer is the right minimum
HELD_OUT = 2e-4  # [m] rms of a cast that was not fitted: the goal
SECONDS = 2.0  # of one core: the goal
ESTIMATES = Table(
    "estimates",
    "a row for each set of casts and each way to estimate eight parameters from it",
    (
        Column("contender", "", "way", "text"),
        Column("seed", "1", "of the set", "int"),
        Column("string", "", "of the virtual lab, or drawn", "text"),
        Column("matched", "", "what was measured is a chain like the one that is fitted", "bool"),
        Column("seconds", "s", "processor time of one thread"),
        Column("simulations", "1", "strings simulated, each in one trial", "int"),
        Column("simulated", "s", "their time in all"),
        Column("held_out", "m", "root mean square of a cast without noise that was not fitted"),
        Column("least", "m", "the same from the minimum beside the truth"),
        Column("above", "1", "how far below its maximum beside the truth the log-likelihood is"),
    ),
)


def ours(given: CastSet) -> np.ndarray:
    """The estimate stage as it is configured, E and intervals included."""
    settings = configured("estimate/least_squares.yaml")
    settings["matching"] = Matching(**settings["matching"])
    found = least_squares.estimate(model(), given.trials, None, seed=0, manipulation=1, **settings)
    return model().values(found.values())


def scipy(given: CastSet) -> np.ndarray:
    """SciPy's trust region on the same residuals, from the best of as many random strings; slopes in our batches."""
    settings = configured("estimate/least_squares.yaml")
    likelihood = likelihood_of(given)
    drawn = np.random.default_rng([0, 1]).uniform(0, 1, (settings["screening"], len(model().parameters)))
    start = np.clip(screened(likelihood, drawn, 1)[0], 1e-6, 1 - 1e-6)

    def residual(chi: np.ndarray) -> np.ndarray:
        return likelihood.residuals(chi[None])[0]

    def jacobian(chi: np.ndarray) -> np.ndarray:
        return slopes(likelihood, chi[None], residual(chi)[None], np.full((1, len(chi)), FIRST))[0].T

    found = trust_region(residual, start, jacobian, bounds=(0, 1), x_scale="jac", max_nfev=100)
    return values_of(model().parameters, found.x)


CONTENDERS: dict[str, Callable[[CastSet], np.ndarray]] = {"least_squares": ours, "scipy": scipy}


def likelihood_of(given: CastSet) -> Likelihood:
    """Of the set's trials."""
    return Likelihood(model(), tuple(case(model(), trial) for trial in given.trials))


@contextmanager
def counted() -> Iterator[list[tuple[int, float]]]:
    """How many strings are simulated, and for how long each [s], call by call."""
    calls: list[tuple[int, float]] = []

    def noted(simulate, string, hand, values, times, *more):  # type: ignore[no-untyped-def]
        calls.append((len(values), float(np.max(times) - hand.start)))
        return simulate(string, hand, values, times, *more)

    with ExitStack() as stack:
        for module in (batch, forward_model):
            stack.enter_context(patch.object(module, "simulate", partial(noted, module.simulate)))
        yield calls


def row(name: str, seed: int) -> dict[str, object]:
    """One contender on one set."""
    given = drawn(seed)
    with counted() as calls:
        begun = time.thread_time()
        found = CONTENDERS[name](given)
        seconds = time.thread_time() - begun
    likelihood, held_out = likelihood_of(given), case(model(), given.held_out)
    parameters = model().parameters
    here, truth = (chi_of(parameters, values)[None] for values in (found, given.truth))
    judge, best = refined(likelihood, truth[0])
    least, left = (loss(judge.residuals(chi), judge.limit)[0] for chi in (best[None], here))
    above = 0.5 * judge.residuals(here).size * np.log(left / least)
    off = [np.sqrt(held_out.off(values)[0]) for values in (found, values_of(parameters, best))]
    counts = {"simulations": sum(n for n, _ in calls), "simulated": sum(n * t for n, t in calls)}
    about = {"contender": name, "seed": seed, "string": given.name, "matched": seed < MATCHED}
    return about | counts | {"seconds": seconds, "held_out": off[0], "least": off[1], "above": above}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Of each contender, on matched sets and on the others."""
    marked = rows.assign(
        right=rows["above"] < NEAR,
        goal=(rows["held_out"] < HELD_OUT) & (rows["seconds"] <= SECONDS),
        held_out_mm=1e3 * rows["held_out"],
        over_least=rows["held_out"] / rows["least"],
    )
    parts = marked.groupby(["contender", "matched"])
    return pd.DataFrame(
        {
            "sets": parts.size(),
            "right": parts["right"].sum(),
            "0.2 mm in 2 s": parts["goal"].sum(),
            "seconds": parts["seconds"].median(),
            "slowest": parts["seconds"].max(),
            "simulations": parts["simulations"].median(),
            "held out / mm": parts["held_out_mm"].median(),
            "worst / mm": parts["held_out_mm"].max(),
        }
    )


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser("python -m tests.speed.estimates", description=__doc__)
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--only", nargs="*", default=list(CONTENDERS), choices=list(CONTENDERS))
    parser.add_argument("--out", type=Path, default=ROOT / "outputs" / "speed" / "estimates.parquet")
    asked = parser.parse_args()
    numba.set_num_threads(1)
    row(asked.only[0], 0)  # compiles
    rows = []
    for seed in range(asked.sets):
        rows += [row(name, seed) for name in asked.only]
        print(pd.DataFrame(rows[-len(asked.only) :]).round(5).to_string(index=False, header=seed == 0), flush=True)
    write_table(ESTIMATES, pd.DataFrame(rows), asked.out, {"command": "python -m tests.speed.estimates"})
    print(summary(pd.DataFrame(rows)).round(3).to_string())


if __name__ == "__main__":
    main()
