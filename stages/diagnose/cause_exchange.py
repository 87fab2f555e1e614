"""Exchange of two causes at once: a rival of an earlier one, and what goes with it.

While something is missing, a look-alike may explain more than the cause that is there,
and the next cause that is found goes with it. Neither can be exchanged alone: each is
the best beside the other. So the rivals of a cause that was accepted are also fitted
beside look-alikes of the earlier ones, as in a floating search (Pudil, Novovičová,
Kittler, Pattern Recognition Letters 15, 1119, 1994).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np

from stringcast.stages.diagnose.candidate_comparison import by_evidence, fit_roughly
from stringcast.stages.diagnose.common_data import fit_to_common_data
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.diagnose.selection_state import SelectionState, with_fit
from stringcast.stages.inference.hypothesis import Hypothesis

log = logging.getLogger(__name__)

MAX_LOOKALIKES = 2  # of each earlier cause
MAX_COMPARED = 2  # exchanges that are fitted to common data


def exchange_two_causes(state: SelectionState, criteria: Criteria) -> SelectionState:
    """Exchange the cause accepted last and an earlier one if that explains more.

    Only exchanges that lose less than half of what the last cause has gained are
    compared on common data.
    """
    data = state.prepared.data
    fits = []
    for hypothesis, starts in _exchanges(state):
        fit = fit_roughly(data, hypothesis, starts, state.fit)
        fits.append(fit)
        gain = fit.log_evidence - state.fit.log_evidence
        log.info("%s: log evidence %+.1f", " + ".join(hypothesis.cause_names), gain)
    least_evidence = _least_evidence(state, criteria)
    rivals = [fit for fit in fits if fit.log_evidence > least_evidence]
    others = by_evidence(rivals)[:MAX_COMPARED]
    if not others:
        return state
    current, *compared = fit_to_common_data(state.prepared, [state.fit, *others])
    best = by_evidence(compared)[0]
    gain = best.log_evidence - current.log_evidence
    names = " + ".join(best.hypothesis.cause_names)
    log.info("on common data: %s, log evidence %+.1f", names, gain)
    return with_fit(state, best) if gain > 0 else state


def _least_evidence(state: SelectionState, criteria: Criteria) -> float:
    """Compute the evidence of an exchange that may lead on common data."""
    last = [step for step in state.steps if step.accepted][-1]
    assert last.best is not None
    gain = last.best.log_evidence - last.parent.log_evidence
    return state.fit.log_evidence - criteria.min_explained_fraction * gain


def _exchanges(state: SelectionState) -> Iterator[tuple[Hypothesis, np.ndarray]]:
    """Combine look-alikes of earlier causes with rivals of the last, and their starts.

    Yields a hypothesis and exponents (2, P): the shared ones are those beside either.
    """
    *earlier, last = [step for step in state.steps if step.accepted]
    base = state.fit.hypothesis.base
    causes = state.fit.hypothesis.causes
    for step in earlier:
        assert step.best is not None
        replaced = step.best.hypothesis.causes[-1]
        if replaced not in causes[:-1]:
            continue  # it was dropped or exchanged since
        kept = [c for c in causes[:-1] if c is not replaced]
        for lookalike in step.compared[1 : 1 + MAX_LOOKALIKES]:
            for rival in last.compared:
                pair = [fit.hypothesis.causes[-1] for fit in (lookalike, rival)]
                if len({*kept, *pair}) < len(causes):
                    continue  # one cause twice
                hypothesis = Hypothesis(base, (*kept, *pair))
                beside_rival = lookalike.exponents | rival.exponents
                beside_lookalike = rival.exponents | lookalike.exponents
                starts = [beside_rival, beside_lookalike]
                yield (
                    hypothesis,
                    np.stack([hypothesis.exponents_from(start) for start in starts]),
                )
