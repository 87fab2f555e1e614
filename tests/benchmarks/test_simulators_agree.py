"""Three simulators of one swing: the nodal rod, PyElastica's and the own kernel."""

import numpy as np
import pytest

from tests.benchmarks.simulators import load_simulator
from tests.benchmarks.simulators.hand import GraspPath
from tests.benchmarks.simulators.rod import Rod
from tests.benchmarks.simulators.scene import Fidelity

pytestmark = pytest.mark.long
PLAIN = Rod(0.3, 700.0, 0.03, 6e-3, 5e-6, 0.3, 0.2, 0.07, 1e-4)
ARC = np.array([0.15, 0.3])
T = np.linspace(0, 0.6, 121)


@pytest.fixture(scope="module")
def path():
    x = np.clip((T - 0.02) / 0.3, 0, 1)
    progress = 10 * x**3 - 15 * x**4 + 6 * x**5
    pose = [0.15 * progress, 0 * progress, -np.pi / 2 + 0.8 * progress]
    return GraspPath.fit(T, np.stack(pose, axis=-1))


def swing(simulator, rod, path, fidelity=Fidelity.FINAL):
    motion = load_simulator(simulator).move(rod, path, fidelity)
    return motion.points(T, ARC)


def largest_distance(one, other):
    return np.linalg.norm(one - other, axis=-1).max()


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tip_mass": 0.2, "taper": 0.5},
        {"rest_curvature": 3.0, "wind_x": 0.5},
        {"gravity_x": 1.0, "cross_drag": 1.0},
    ],
)
def test_pyelastica_agrees_with_the_nodal_rod(path, changes):
    """PyElastica and the nodal rod agree, although they share outer forces alone."""
    pytest.importorskip("elastica")
    rod = PLAIN._replace(**changes)
    nodal = swing("nodal", rod, path)
    cosserat = swing("pyelastica", rod, path)
    check = swing("pyelastica", rod, path, Fidelity.CHECK)
    assert largest_distance(nodal, nodal[0]) > 0.1
    assert largest_distance(cosserat, check) < 5e-4
    assert largest_distance(nodal, cosserat) < 5e-4


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"soft_spot": 0.8, "soft_spot_place": 0.1},
        {"attraction": 30.0, "attraction_x": 0.3, "attraction_y": -0.2},
        {"vortex": 10.0, "vortex_x": 0.1, "vortex_y": -0.2},
        {"gust_x": 5.0, "gust_y": 3.0, "gust_when": 0.2},
        {"blow_x": 300.0, "blow_when": 0.2},
        {"grip": 200.0, "grip_from": 0.15, "grip_until": 0.25},
    ],
)
def test_the_own_kernel_agrees_with_the_nodal_rod(path, changes):
    """Both simulators move a plain rod alike.

    They also move a rod with a cause outside the library alike.
    """
    rod = PLAIN._replace(**changes)
    nodal, own = swing("nodal", rod, path), swing("own_kernel", rod, path)
    assert largest_distance(nodal, own) < 1e-3
    if changes:
        moved = largest_distance(nodal, swing("nodal", PLAIN, path))
        assert moved > 5e-3
        assert largest_distance(nodal, own) < 0.1 * moved
