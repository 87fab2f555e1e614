"""An interrupted diagnosis reports its results so far, and names nothing."""

import json
from types import SimpleNamespace

import pytest
import yaml
from synthetic_trials import CRITERIA

from stringcast.stages.common import InterruptRequest
from stringcast.stages.diagnose import cause_search, verdict
from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose.posteriors import SingleEffectPosterior
from stringcast.stages.diagnose.selection_state import SelectionState
from stringcast.stages.diagnose.selection_step import SelectionStep
from tests.diagnosis import test_forward_selection
from tests.diagnosis.test_forward_selection import diagnose_casts


def interrupt(*given):
    raise InterruptRequest


def test_accepted_causes_are_reported_and_none_is_named(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "swap_lookalikes_until_stable", interrupt)
    monkeypatch.setattr(test_forward_selection, "EFFECTS", ("tip_mass", "wind"))
    diagnosis = diagnose_casts(arm, camera, {"tip_mass.ratio": 0.05}, monkeypatch)
    document = json.loads(diagnosis.finding["diagnosis"].iloc[0])
    assert document["verdict"] == "insufficient"
    assert document["interrupted"]
    assert document["causes"] == []
    sentence = document["unexplained"]["sentence"]
    assert "interrupted; so far it had found tip mass (1.00)" in sentence
    assert "cannot answer" not in diagnosis.sentence
    rows = document["alternatives"]
    probable = [row["effect"] for row in rows if row["probability"] > 0.5]
    assert probable == ["tip_mass"]
    extended = yaml.safe_load(diagnosis.finding["extended"].iloc[0])
    assert extended["effects"] == []
    assert len(diagnosis.held_out) == 0
    assert diagnosis.hypotheses["causes"].str.contains("tip_mass").any()
    assert set(diagnosis.entries["cause"]) == {"tip_mass"}


def test_a_cause_that_was_dropped_is_not_reported(monkeypatch):
    """A cause that was dropped is not reported.

    Of two that were accepted, the first was not needed in addition to the second.
    """
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

    monkeypatch.setattr(verdict, "background_responses", lambda *given: ())
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
