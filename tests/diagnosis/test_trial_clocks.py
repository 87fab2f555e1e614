"""Clocks of arm and camera that differ from trial to trial, after a diagnosis."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import measured_sample

from stringcast.pipeline.commands.clock_fit import plain_model
from stringcast.stages.diagnose import diagnose
from stringcast.stages.diagnose.clocks import trial_clocks
from stringcast.stages.diagnose.clocks.trial_clocks import find_trial_clocks
from stringcast.stages.diagnose.results.document import clocks_document
from stringcast.stages.diagnose.trials.preparation import prepare_data
from stringcast.stages.diagnose.verdict import Judgement, Verdict
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import fit_hypothesis
from stringcast.stages.model.effects.time_offset import TimeOffset
from stringcast.stages.model.effects.wind import Wind

CHECKED = measured_sample()  # it hides a wind
MODEL = plain_model(CHECKED)


def prepare(change):
    """Prepare three trials of the sample, with points changed by trial number."""
    changed = []
    for number, seen in enumerate(CHECKED.trials[:3]):
        points = change(number, seen.points)
        changed.append(replace(seen.observation, points=points))
    rng = np.random.default_rng(0)
    return prepare_data(MODEL, changed, 2e-3, rng, 2, lambda share: None)


LATE_S = (0.0, 0.0135, -0.0107)  # advance of the camera's clock in each trial


@pytest.fixture(scope="module")
def with_own_clocks():
    return prepare(lambda k, points: points.assign(t=points["t"] + LATE_S[k]))


def test_clocks_that_differ_by_a_few_frames_are_found_from_the_base_model(
    with_own_clocks,
):
    found = find_trial_clocks(with_own_clocks.data, with_own_clocks.base_fit)
    for late_s, interval in zip(LATE_S, found.values(), strict=True):
        assert interval.low < -late_s < interval.high
    document = clocks_document(found)
    assert document["offsets"]["t01"]["value"] == pytest.approx(-0.0135, abs=1e-3)
    ends = r" -1\d\.\d ms in t01 .* \+1\d\.\d ms in t02"
    assert re.search(ends, document["sentence"])


def test_clocks_are_exact_if_the_fit_has_the_cause_that_is_active(with_own_clocks):
    data = with_own_clocks.data
    base = with_own_clocks.base_fit
    hypothesis = Hypothesis(base.hypothesis.base, (Wind,))
    start = hypothesis.exponents_from(base.exponents)
    fit = fit_hypothesis(data, hypothesis, start[None], base.grid_points)
    found = find_trial_clocks(data, fit)
    values = [interval.value for interval in found.values()]
    assert values == pytest.approx([-late_s for late_s in LATE_S], abs=2e-4)


@pytest.mark.parametrize("acceleration_m_s2", [0.0, 3.5])
def test_trials_with_one_clock_do_not_differ(acceleration_m_s2):
    """Neither the hidden wind nor an unknown push after 0.25 s looks like clocks."""

    def push(number, points):
        since_onset_s = np.maximum(points["t"] - points["t"].min() - 0.25, 0.0)
        push_m = (acceleration_m_s2 + 0.3 * number) / 2 * since_onset_s**2
        return points.assign(x=points["x"] + push_m * points["s"] / points["s"].max())

    prepared = prepare(push)
    assert find_trial_clocks(prepared.data, prepared.base_fit) is None


def test_the_clock_of_one_trial_is_not_fitted(with_own_clocks, monkeypatch):
    """It differs from no other one."""
    data = with_own_clocks.data.subset([0])
    fitted = []
    monkeypatch.setattr(
        trial_clocks, "fit_hypothesis", lambda *given: fitted.append(given)
    )
    assert find_trial_clocks(data, with_own_clocks.base_fit) is None
    assert not fitted


@pytest.mark.parametrize(
    ("misfit_probability", "model", "is_asked"),
    [(0.9, MODEL, True), (0.0, MODEL, False), (0.9, MODEL.with_effects(TimeOffset), 0)],
)
@pytest.mark.parametrize("named", [(), ("wind",)])
def test_clocks_are_compared_with_the_named_causes_if_misfit_remains(
    misfit_probability, model, is_asked, named, monkeypatch
):
    """Clocks that are in the model are known."""
    used = []
    monkeypatch.setattr(
        diagnose, "find_trial_clocks", lambda data, fit: used.append(fit)
    )
    verdict = Verdict("partial", misfit_probability, named)
    judgement = Judgement(verdict, None, (), "base fit", ())
    with_wind = SimpleNamespace(hypothesis=SimpleNamespace(cause_names=("wind",)))
    state = diagnose.SelectionState(SimpleNamespace(data=None), with_wind)
    settings = SimpleNamespace(model=model)
    diagnose._with_trial_clocks(state, judgement, settings)
    assert used == ([with_wind if named else "base fit"] if is_asked else [])
