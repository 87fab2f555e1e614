"""The arithmetic of the error budget."""

from types import SimpleNamespace

import numpy as np

from stringcast.stages.diagnose.results import budget


def test_a_cause_that_explains_nothing_has_a_share_of_zero(monkeypatch):
    """The share of a cause that explains nothing by itself is zero, not negative.

    The misfit is 2.0 mm, 2.1 mm with the first cause, and 1.0 mm with both.
    """
    clamp, curvature = SimpleNamespace(name="clamp"), SimpleNamespace(name="set")
    off_m = {(): 2.0e-3, (clamp.name,): 2.1e-3, (clamp.name, curvature.name): 1.0e-3}

    def fit(*causes):
        names = tuple(cause.name for cause in causes)
        hypothesis = SimpleNamespace(causes=causes, without_cause=lambda cause: None)
        return SimpleNamespace(
            hypothesis=hypothesis, residuals=names, grid_points=None, log_evidence=0.0
        )

    data = SimpleNamespace(
        without_nuisance=lambda names, indices: off_m[names],
        tip_rms_by_trial=lambda off: np.full(2, off),
    )
    data.for_hypothesis = lambda hypothesis: data
    full = fit(clamp, curvature)
    state = SimpleNamespace(prepared=SimpleNamespace(data=data), fit=full)
    fits = [fit(), fit(clamp), full]
    monkeypatch.setattr(budget, "nested_fits", lambda state, base: fits)
    monkeypatch.setattr(budget, "refit", lambda *given: fit())
    monkeypatch.setattr(
        budget, "_noise_and_numerical_mean_squares", lambda prepared: (0.0, 0.0)
    )
    monkeypatch.setattr(
        budget, "sample_discrepancy_tip_rms", lambda *given: np.ones((2, 4))
    )
    entries = budget.error_budget(state, None, None).entries
    sizes = np.array([entry.tip_rms_m for entry in entries])
    expected = [0.0, np.sqrt(3) * 1e-3, 0.0, 0.0, 1e-3]
    np.testing.assert_allclose(sizes, expected, atol=1e-12)
    assert not np.signbit(sizes).any()
