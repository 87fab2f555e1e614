"""A diagnosis that is interrupted ends with what it knows, and names nothing."""

import json
from types import SimpleNamespace

import pytest
import yaml

from stringcast.stages.common import InterruptRequest
from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose import verdict
from stringcast.stages.diagnose.forward_selection import SelectionState, SelectionStep
from stringcast.stages.diagnose.verdict import SingleEffectPosterior
from tests.diagnosis.performed import CRITERIA
from tests.diagnosis.test_single_effects import casts, said_of


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
        "interrupted, when it had come to tip_mass (1.00)"
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


def test_what_left_again_is_not_said_to_be_at_work(monkeypatch):
    """Of two that entered, the first was not needed beside the second."""
    asked = []
    hypotheses = {
        n: SimpleNamespace(names=n, base=None, causes=n)
        for n in (("a",), ("a", "b"), ("b",))
    }
    fit = SimpleNamespace(hypothesis=hypotheses["b",])
    steps = [
        SelectionStep(
            None, (), [SimpleNamespace(hypothesis=hypotheses[n])], accepted=True
        )
        for n in (("a",), ("a", "b"))
    ]
    found = SelectionState(
        SimpleNamespace(data=SimpleNamespace(trials=(1, 2)), base=None), fit, steps
    )
    monkeypatch.setattr(verdict, "background_responses", lambda *given: ())
    monkeypatch.setattr(verdict, "refit", lambda *given: None)
    monkeypatch.setattr(verdict, "Hypothesis", lambda base: None)
    monkeypatch.setattr(verdict, "misfit_probability", lambda *given: 1.0)
    monkeypatch.setattr(
        verdict,
        "_single_effect_posterior",
        lambda data, step, *given: (
            asked.append(step) or SingleEffectPosterior({"b": 0.9, "": 0.1}, {}, None)
        ),
    )
    known = verdict.judge_interrupted_search(found, (), CRITERIA, 0)
    assert asked == steps[1:]
    assert known.remark.endswith("when it had come to b (0.90).")


def test_before_there_is_a_base_model_nothing_is_known(arm, camera, monkeypatch):
    monkeypatch.setattr(module, "prepare_data", interrupt)
    with pytest.raises(KeyboardInterrupt):
        said_of(*casts(arm, camera, [], {}), monkeypatch)
