"""Rivals on the data that were corrected for each of them."""

from types import SimpleNamespace

import numpy as np

from stringcast.stages.diagnose import common_data
from stringcast.stages.inference.laplace import Fit


def fit_of(name, exponents, log_evidence=0.0):
    """Return a fit of exponents by name, as far as a comparison knows it."""
    hypothesis = SimpleNamespace(name=name, model=SimpleNamespace(names=[*exponents]))
    hypothesis.parameters = [SimpleNamespace(name=each) for each in exponents]
    hypothesis.exponents_from = lambda known: np.array([known[e] for e in exponents])
    chi = np.array([*exponents.values()])
    scales = np.array([3])
    return Fit(hypothesis, chi, [], [], None, scales, np.zeros(1), log_evidence)


def test_each_rival_is_fitted_to_the_data_of_each_other(monkeypatch):
    fits = {
        "": fit_of("base", {"stiffness": 0.1}, 1.0),
        "wind": fit_of("wind", {"stiffness": 0.2, "speed": 0.5}, 2.0),
        "set": fit_of("set", {"stiffness": 0.3, "curvature": 0.6}, 3.0),
    }

    def fit(data, hypothesis, starts, scale_indices, min_gain):
        called.append((data, hypothesis.name, starts.tolist()))
        assert scale_indices == [3]
        return fit_of(hypothesis.name, {"stiffness": 0.0}, 10.0)

    def add_random_effects(data, hypothesis, chi):
        return f"{data}, with {hypothesis.name}"

    called = []
    monkeypatch.setattr(common_data, "fit_hypothesis", fit)
    monkeypatch.setattr(common_data, "with_random_effects", add_random_effects)
    data = {"wind": "data of wind", "set": "data of set"}
    fits_by_data = common_data.fit_to_common_data(fits, data)

    # From where it was, and with what it has in common as the other has it
    assert called == [
        ("data of wind, with base", "base", [[0.1], [0.2]]),
        ("data of wind, with set", "set", [[0.3, 0.6], [0.2, 0.6]]),
        ("data of set, with base", "base", [[0.1], [0.3]]),
        ("data of set, with wind", "wind", [[0.2, 0.5], [0.3, 0.5]]),
    ]
    assert fits_by_data["wind"]["wind"] is fits["wind"]
    assert fits_by_data["set"]["wind"].hypothesis is fits["wind"].hypothesis
