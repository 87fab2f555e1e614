"""A diagnosis that is interrupted ends with what it knows, and names nothing."""

import json
from types import SimpleNamespace

import pytest
import yaml

from stringcast.stages.common import InterruptRequest
from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose import verdict
from stringcast.stages.diagnose.forward_selection import SelectionState, SelectionStep
from stringcast.stages.diagnose.posteriors import SingleEffectPosterior
from tests.diagnosis.performed import CRITERIA
from tests.diagnosis.test_forward_selection import casts, said_of


def interrupt(*given):
    raise InterruptRequest


def test_what_had_entered_is_said_and_nothing_is_named(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "swap_lookalikes_until_stable", interrupt)
    made = said_of(
        *casts(arm, camera, ["tip_mass"], {"tip_mass.ratio": 0.05}), monkeypatch
    )
    said = json.loads(made.finding["diagnosis"].iloc[0])
    assert (said["verdict"], said["interrupted"], said["causes"]) == (
        "insufficient",
        True,
        [],
    )
    assert (
        "interrupted; so far it had found tip_mass (1.00)"
        in said["unexplained"]["sentence"]
    )
    assert "cannot answer" not in made.sentence
    assert {
        each["effect"] for each in said["alternatives"] if each["probability"] > 0.5
    } == {"tip_mass"}
    assert yaml.safe_load(made.finding["extended"].iloc[0])["effects"] == []
    assert len(made.held_out) == 0
    assert made.hypotheses["causes"].str.contains("tip_mass").any()
    assert set(made.entries["cause"]) == {"tip_mass"}


def test_a_cause_that_was_dropped_is_not_reported(monkeypatch):
    """Of two that were accepted, the first was not needed in addition to the second."""
    weighed = []
    hypotheses = {
        names: SimpleNamespace(cause_names=names, base=None, causes=names)
        for names in (("a",), ("a", "b"), ("b",))
    }
    steps = []
    for names in (("a",), ("a", "b")):
        fit = SimpleNamespace(hypothesis=hypotheses[names])
        steps.append(SelectionStep(None, (), [fit], accepted=True))
    data = SimpleNamespace(trials=(1, 2))
    prepared = SimpleNamespace(data=data, base_fit=None)
    fit = SimpleNamespace(hypothesis=hypotheses["b",])
    state = SelectionState(prepared, fit, steps)

    def posterior(data, step, *given):
        weighed.append(step)
        return SingleEffectPosterior({"b": 0.9, "": 0.1}, {}, None)

    monkeypatch.setattr(verdict, "background_responses", lambda *given: ())
    monkeypatch.setattr(verdict, "refit", lambda *given: None)
    monkeypatch.setattr(verdict, "Hypothesis", lambda base: None)
    monkeypatch.setattr(verdict, "misfit_probability", lambda *given: 1.0)
    monkeypatch.setattr(verdict, "single_effect_posterior", posterior)
    judgement = verdict.judge_interrupted_search(state, (), CRITERIA, 0)
    assert weighed == steps[1:]
    assert judgement.verdict.remark.endswith("so far it had found b (0.90).")


def test_before_there_is_a_base_model_nothing_is_known(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "prepare_data", interrupt)
    with pytest.raises(KeyboardInterrupt):
        said_of(*casts(arm, camera, [], {}), monkeypatch)
