"""Residuals of candidates are the same whether or not they were simulated recently."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.inference import trial_data
from stringcast.stages.inference.trial_data import CACHED_CANDIDATES, TrialData
from stringcast.stages.model.parameter import Parameter

PARAMETERS = (
    Parameter("one", "1", "", 1.0, 2.0, 1.5),
    Parameter("two", "1", "", 1.0, 2.0, 1.5),
)


@pytest.fixture
def simulated(monkeypatch):
    """Return data of two trials, and a list of the candidates in each simulation."""
    asked = []

    def away(model, trials, values):
        asked.append(len(values))
        return [values * model.factor, values[:, :1] + model.factor]

    monkeypatch.setattr(trial_data, "normalised_residuals", away)
    return TrialData(()), asked


def test_the_best_of_a_batch_is_not_simulated_again_and_is_another_with_another_model(
    simulated,
):
    data, asked = simulated
    plain, other = (
        SimpleNamespace(parameters=PARAMETERS, names=("one", "two"), factor=f)
        for f in (1.0, 3.0)
    )
    batch = np.random.default_rng(0).uniform(size=(5, 2))
    first = data.residuals(plain, batch)
    for k in (4, 1):
        again = data.residuals(plain, batch[k : k + 1])
        assert [each.tolist() for each in again] == [
            each[k : k + 1].tolist() for each in first
        ]
    assert asked == [5]
    assert data.residuals(other, batch[:1])[0] == pytest.approx(3 * first[0][:1])
    assert asked == [5, 1]


def test_what_was_simulated_long_ago_is_simulated_again(simulated):
    data, asked = simulated
    plain = SimpleNamespace(parameters=PARAMETERS, names=("one", "two"), factor=1.0)
    batch = np.random.default_rng(0).uniform(size=(CACHED_CANDIDATES + 1, 2))
    data.residuals(plain, batch)
    data.residuals(plain, batch[1:2])
    data.residuals(plain, batch[:1])
    assert asked == [CACHED_CANDIDATES + 1, 1]
