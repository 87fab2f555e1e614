"""What is said of a cause beside its values."""

from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.stages.diagnose.tables import at_an_end
from stringcast.stages.model.library import library


@pytest.mark.parametrize(
    ("name", "chi", "ends"),
    [
        ("wind", (0.0, 0.4), "wind.along_x"),
        ("wind", (0.0, 1.0), "wind.along_x and wind.along_y"),
        ("wind", (0.01, 0.4), ""),
        ("tip_mass", (1.0,), "tip_mass.ratio"),
        ("tip_mass", (0.0,), ""),  # absent
        ("contact", (1.0, 0.5, 0.5, 1.0, 1.0), ""),  # as stiff as that at least; friction and loss are not its size
    ],
)
def test_a_size_at_an_end_of_its_range_is_said_to_be_there(name, chi, ends):
    effect = library()[name]
    places = {p.name: k for k, p in enumerate(effect.parameters)}
    start = np.array([float(p.chi(np.asarray(p.start))) for p in effect.parameters])
    hypothesis = SimpleNamespace(places=lambda cause, some: [places[p.name] for p in some], carried=lambda known: start)
    fit = SimpleNamespace(hypothesis=hypothesis, chi=np.array(chi))
    said = f", with {ends} at the end of the range: it may stand for what the library does not hold" if ends else ""
    assert at_an_end(fit, effect) == said
