"""Exchange of two causes at once.

While a cause is missing, a look-alike may explain more than a real cause, and the next
cause may then be a complement of this look-alike. Neither can be exchanged alone: each
is the best with the other. So rivals of an accepted cause are also fitted together with
rivals of earlier ones, as in a floating search (Pudil, Novovičová, Kittler, Pattern
Recognition Letters 15, 1119, 1994).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from stringcast.stages.diagnose.evidence.measures import fit_in_workers
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.search.selection_state import SelectionState, with_fit
from stringcast.stages.diagnose.search.selection_step import (
    SelectionStep,
    by_evidence,
    precision_to_rank,
)
from stringcast.stages.diagnose.trials.common_data import fit_to_common_data
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, fit_hypothesis

log = logging.getLogger(__name__)

MAX_RIVALS = 2  # of each earlier cause
MAX_COMPARED = 2  # exchanges that are fitted to common data


def exchange_two_causes(state: SelectionState, criteria: Criteria) -> SelectionState:
    """Exchange the last accepted cause and an earlier one if that explains more.

    Only exchanges that keep at least half of the last cause's gain are compared on
    common data.
    """
    *earlier, last = [step for step in state.steps if step.accepted]
    exchanges = list(_exchanges(state, earlier, last))
    min_gain = precision_to_rank(last.best_gain)

    def fit_exchange(number: int) -> Fit:
        hypothesis, starts = exchanges[number]
        data = state.prepared.data
        grid_points = state.fit.grid_points
        fit = fit_hypothesis(data, hypothesis, starts, grid_points, min_gain)
        gain = fit.log_evidence - state.fit.log_evidence
        log.info("%s: log evidence %+.1f", " + ".join(hypothesis.cause_names), gain)
        return fit

    most_lost = (1 - criteria.min_explained_fraction) * last.best_gain
    least_evidence = state.fit.log_evidence - most_lost
    fits = fit_in_workers(fit_exchange, [hypothesis for hypothesis, _ in exchanges])
    rivals = [fit for fit in fits if fit.log_evidence > least_evidence]
    if not rivals:
        return state

    others = by_evidence(rivals)[:MAX_COMPARED]
    current, *compared = fit_to_common_data(state.prepared, [state.fit, *others])
    best = by_evidence(compared)[0]
    gain = best.log_evidence - current.log_evidence
    names = " + ".join(best.hypothesis.cause_names)
    log.info("on common data: %s, log evidence %+.1f", names, gain)
    return with_fit(state, best) if gain > 0 else state


def _exchanges(
    state: SelectionState, earlier: Sequence[SelectionStep], last: SelectionStep
) -> Iterator[tuple[Hypothesis, np.ndarray]]:
    """Combine rivals of earlier causes with those of the last, with their starts.

    Yields a hypothesis and exponents (2, P): shared parameters first from the fit of
    the last cause, then from that of the earlier one.
    """
    causes = state.fit.hypothesis.causes
    for step in earlier:
        assert step.best is not None
        replaced = step.best.hypothesis.causes[-1]
        if replaced not in causes[:-1]:
            continue  # dropped or exchanged since
        kept = [c for c in causes[:-1] if c is not replaced]
        for one, other in product(step.compared[1 : 1 + MAX_RIVALS], last.compared):
            pair = one.hypothesis.causes[-1], other.hypothesis.causes[-1]
            if len({*kept, *pair}) < len(causes):
                continue  # a cause would occur twice
            hypothesis = Hypothesis(state.fit.hypothesis.base, (*kept, *pair))
            from_last = hypothesis.exponents_from(one.exponents | other.exponents)
            from_earlier = hypothesis.exponents_from(other.exponents | one.exponents)
            yield hypothesis, np.stack([from_last, from_earlier])
