"""The error budget's arithmetic."""

from types import SimpleNamespace

import numpy as np

from stringcast.stages.diagnose import budget


def test_a_cause_that_explains_nothing_by_itself_has_nothing_and_not_less(monkeypatch):
    """With the first of two causes the tip is 2.1 mm off instead of 2.0, with both 1.0:
    `-0.00 mm` stood in a page.
    """
    off = {(): 2.0e-3, ("clamp",): 2.1e-3, ("clamp", "set"): 1.0e-3}

    def fit(*names):
        hypothesis = SimpleNamespace(
            names=names, causes=names, without=lambda cause: names
        )
        return SimpleNamespace(
            hypothesis=hypothesis, residuals=names, sizes=None, evidence=0.0
        )

    data = SimpleNamespace(
        begun=lambda names, sizes: off[names], tip_rms=lambda each: np.full(2, each)
    )
    data.of = lambda hypothesis: data
    found = SimpleNamespace(
        prepared=SimpleNamespace(data=data), fit=fit("clamp", "set")
    )
    monkeypatch.setattr(
        budget,
        "nested_fits",
        lambda found, base: [fit(), fit("clamp"), fit("clamp", "set")],
    )
    monkeypatch.setattr(budget, "refit", lambda *given: fit())
    monkeypatch.setattr(
        budget, "_noise_and_numerical_mean_squares", lambda prepared: (0.0, 0.0)
    )
    monkeypatch.setattr(
        budget, "sample_discrepancy_tip_rms", lambda *given: np.ones((2, 4))
    )
    entries = budget.error_budget(found, None, None).entries
    sizes = np.array([entry.tip_rms_m for entry in entries])
    np.testing.assert_allclose(
        sizes, [0.0, np.sqrt(3) * 1e-3, 0.0, 0.0, 1e-3], atol=1e-12
    )
    assert not np.signbit(sizes).any()
