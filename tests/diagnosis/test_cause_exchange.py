"""Exchange of two causes at once, each of them the best with the other."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ordinary
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose.search import cause_exchange
from stringcast.stages.diagnose.search.selection_state import SelectionState
from stringcast.stages.diagnose.search.selection_step import SelectionStep
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit
from stringcast.stages.model.library import effects_by_name


def fit_of(base, names, log_evidence=0.0):
    """Return a fit of causes by their names, at their starts."""
    causes = tuple(effects_by_name()[name] for name in names)
    hypothesis = Hypothesis(base, causes)
    chi = hypothesis.exponents_from({})
    return Fit(hypothesis, chi, [], [], chi, np.zeros(1), np.zeros(1), log_evidence)


@pytest.fixture
def state(arm):
    """Return a search that has accepted a clamp, a turned camera, and a contact."""
    base = ordinary(arm)

    def step(before, *rivals):
        parent = fit_of(base, before)
        fits = [fit_of(base, (*before, rival), 40.0) for rival in rivals]
        return SelectionStep(None, parent, (), fits, fits, accepted=bool(fits))

    steps = [
        step((), "clamp"),
        step(("clamp",), "camera_rotation", "rest_curvature", "grasp_angle", "wind"),
        step(("clamp", "camera_rotation")),  # nothing was accepted at first
        step(("clamp", "camera_rotation"), "contact", "rest_curvature"),
    ]
    fit = fit_of(base, ("clamp", "camera_rotation", "contact"), 100.0)
    return SelectionState(SimpleNamespace(data="data"), fit, steps)


@pytest.mark.parametrize(
    ("rough", "common", "ended"),
    [
        # the leading rough fit may not be the best in the end
        ((130.0, 120.0), (110.0, 140.0), "grasp_angle"),
        ((130.0, 90.0), (110.0, 105.0), "rest_curvature"),
        ((130.0, 120.0), (99.0, 98.0), "camera_rotation"),
        # it loses more than half of the last cause's gain
        ((79.0, 81.0), (200.0, 110.0), "grasp_angle"),
    ],
)
def test_two_causes_are_exchanged_if_others_explain_more(
    rough, common, ended, state, monkeypatch
):
    names = ("rest_curvature", "grasp_angle")
    evidence = dict(zip(names, zip(rough, common, strict=True), strict=True))
    tried = []

    def fit_roughly(data, hypothesis, starts, *given):
        tried.append(hypothesis.cause_names)
        assert starts.shape == (2, len(hypothesis.parameters))
        gain = evidence[hypothesis.cause_names[1]][0]
        gain -= 50.0 * (hypothesis.cause_names[2] != "contact")
        return fit_of(hypothesis.base, hypothesis.cause_names, gain)

    def compare(prepared, fits):
        compared = fits[:1]
        for fit in fits[1:]:
            names = fit.hypothesis.cause_names
            compared.append(fit_of(fit.hypothesis.base, names, evidence[names[1]][1]))
        return compared

    monkeypatch.setattr(cause_exchange, "fit_hypothesis", fit_roughly)
    monkeypatch.setattr(
        cause_exchange,
        "fit_in_workers",
        lambda call, hypotheses: [call(k) for k in range(len(hypotheses))],
    )
    monkeypatch.setattr(cause_exchange, "fit_to_common_data", compare)
    monkeypatch.setattr(
        cause_exchange,
        "with_fit",
        lambda state, fit: SelectionState(state.prepared, fit, state.steps),
    )
    exchanged = cause_exchange.exchange_two_causes(state, CRITERIA)
    assert tried == [
        ("clamp", "rest_curvature", "contact"),
        ("clamp", "grasp_angle", "contact"),
        ("clamp", "grasp_angle", "rest_curvature"),
    ]
    kept = exchanged.fit.hypothesis.cause_names
    assert (kept[0], kept[1], kept[2]) == ("clamp", ended, "contact")


def test_a_cause_without_rivals_is_not_exchanged(state, monkeypatch):
    first = SelectionState(state.prepared, state.steps[0].best, state.steps[:1])
    monkeypatch.setattr(cause_exchange, "fit_to_common_data", None)
    assert cause_exchange.exchange_two_causes(first, CRITERIA) is first
