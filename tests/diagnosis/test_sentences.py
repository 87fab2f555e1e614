"""What is said of a cause beside its values."""

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
        # as stiff as that at least; friction and loss are not its size
        ("contact", (1.0, 0.5, 0.5, 1.0, 1.0), ""),
    ],
)
def test_a_size_at_an_end_of_its_range_is_said_to_be_there(name, chi, ends):
    effect = effects_by_name()[name]
    places = {p.name: k for k, p in enumerate(effect.parameters)}
    start = np.array([float(p.chi(np.asarray(p.start))) for p in effect.parameters])
    hypothesis = SimpleNamespace(
        places=lambda cause, some: [places[p.name] for p in some],
        carried=lambda known: start,
    )
    fit = SimpleNamespace(hypothesis=hypothesis, chi=np.array(chi))
    said = (
        f", with {ends} at the end of the range: it may stand for what the library does not hold"
        if ends
        else ""
    )
    assert range_end_remark(fit, effect) == said
