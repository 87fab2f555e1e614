"""Remarks on a cause in addition to its values."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.diagnose.tables import range_end_remark
from stringcast.stages.model.library import effects_by_name


@pytest.mark.parametrize(
    ("name", "chi", "ends"),
    [
        ("wind", (0.0, 0.4), "wind.along_x"),
        ("wind", (0.0, 1.0), "wind.along_x and wind.along_y"),
        ("wind", (0.01, 0.4), ""),
        ("tip_mass", (1.0,), "tip_mass.ratio"),
        ("tip_mass", (0.0,), ""),  # absent
        # a stiffness is known from below; friction and loss are no amplitudes
        ("contact", (1.0, 0.5, 0.5, 1.0, 1.0), ""),
    ],
)
def test_an_amplitude_at_an_end_of_its_range_is_remarked(name, chi, ends):
    effect = effects_by_name()[name]
    indices = {p.name: k for k, p in enumerate(effect.parameters)}
    start = np.array([float(p.chi(np.asarray(p.start))) for p in effect.parameters])
    hypothesis = SimpleNamespace(
        parameter_indices=lambda cause, some: [indices[p.name] for p in some],
        exponents_from=lambda known: start,
    )
    fit = SimpleNamespace(hypothesis=hypothesis, chi=np.array(chi))
    remark = range_end_remark(fit, effect)
    assert remark.startswith(f", with {ends} at the end") if ends else remark == ""
