"""An interrupted diagnosis reports its results but names no cause."""

from types import SimpleNamespace

import pytest
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose import verdict
from stringcast.stages.diagnose.evidence.single_effect import SingleEffectPosterior
from stringcast.stages.diagnose.search import cause_search
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from tests.diagnosis.test_forward_selection import diagnose_casts, interrupt


def test_a_cause_that_was_dropped_is_not_reported(monkeypatch):
    """The first of two accepted causes was redundant after the second."""
    hypotheses = {}
    for names in (("a",), ("a", "b"), ("b",)):
        hypothesis = SimpleNamespace(cause_names=names, base=None, causes=names)
        hypotheses[names] = hypothesis
    steps = []
    for names in (("a",), ("a", "b")):
        fit = SimpleNamespace(hypothesis=hypotheses[names])
        steps.append(SelectionStep(None, None, (), [fit], accepted=True))
    data = SimpleNamespace(trials=(1, 2))
    prepared = SimpleNamespace(data=data, base_fit=None)
    fit = SimpleNamespace(hypothesis=hypotheses["b",])
    state = SelectionState(prepared, fit, steps)
    weighed = []

    def posterior(step, *given):
        weighed.append(step)
        return SingleEffectPosterior({"b": 0.9, "": 0.1}, {}, None, None)

    monkeypatch.setattr(verdict, "find_background", lambda *given: ())
    base_fit = SimpleNamespace(log_evidence=0.0)
    monkeypatch.setattr(verdict, "refit", lambda *given: base_fit)
    monkeypatch.setattr(verdict, "Hypothesis", lambda base: None)
    monkeypatch.setattr(verdict, "misfit_probability", lambda *given: 1.0)
    monkeypatch.setattr(verdict, "single_effect_posterior", posterior)
    judgement = verdict.judge_interrupted_search(state, (), CRITERIA, 0)
    assert weighed == steps[1:]
    assert judgement.verdict.remark.endswith("so far it had found b (0.90).")


def test_without_a_base_model_nothing_is_reported(arm, camera, monkeypatch):
    monkeypatch.setattr(cause_search, "prepare_data", interrupt)
    with pytest.raises(KeyboardInterrupt):
        diagnose_casts(arm, camera, {}, monkeypatch)
