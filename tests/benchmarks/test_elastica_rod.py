"""The rod of PyElastica against the nodal one, with which it shares outer forces alone.
Needs the group `bench`.
"""

import numpy as np
import pytest

from tests.benchmarks.simulators.laboratory import laboratory
from tests.benchmarks.simulators.laboratory.hand import Path
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import CHECK, FINE

pytest.importorskip("elastica")
pytestmark = pytest.mark.long
PLAIN = Rod(0.3, 700.0, 0.03, 6e-3, 5e-6, 0.3, 0.2, 0.07, 1e-4)


@pytest.mark.parametrize(
    "so",
    [
        {},
        {"tip_mass": 0.2, "taper": 0.5},
        {"set_curvature": 3.0, "wind_x": 0.5},
        {"gravity_x": 1.0, "across": 1.0},
    ],
)
def test_two_engines_agree_about_a_swing(so):
    t = np.linspace(0, 0.6, 121)
    x = np.clip((t - 0.02) / 0.3, 0, 1)
    way = 10 * x**3 - 15 * x**4 + 6 * x**5
    path = Path.through(
        t, np.stack([0.15 * way, 0 * way, -np.pi / 2 + 0.8 * way], axis=-1)
    )
    rod, arc = PLAIN._replace(**so), np.array([0.15, 0.3])
    one, other = (
        laboratory(name).moved(rod, path, FINE).points(t, arc)
        for name in ("nodal", "pyelastica")
    )
    check = laboratory("pyelastica").moved(rod, path, CHECK).points(t, arc)
    assert np.linalg.norm(one - one[0], axis=-1).max() > 0.1
    assert np.linalg.norm(other - check, axis=-1).max() < 5e-4
    assert np.linalg.norm(one - other, axis=-1).max() < 5e-4
