"""Laboratories that are not the model: which bench a seed means, and that what is
absent is not there.
"""

import sys
from collections import Counter

import numpy as np
import pytest

from stringcast.data.schema import DataError
from stringcast.stages.model.library import effects_by_name
from tests.benchmarks.simulators.laboratory import bench, drawn, laboratory
from tests.benchmarks.simulators.laboratory.causes import CAUSES, NAMED
from tests.benchmarks.simulators.laboratory.hand import Hand, driven, slid
from tests.benchmarks.simulators.laboratory.rod import Rod
from tests.benchmarks.simulators.laboratory.scene import FINE
from tests.benchmarks.simulators.laboratory.sight import Sight, seen
from tests.benchmarks.simulators.laboratory.version import VERSIONS

T = np.arange(0, 1, 0.001)


def test_every_cause_has_its_turn_and_the_library_knows_its_names():
    version = VERSIONS["nodal"][max(VERSIONS["nodal"])]
    assert {*version.single, *version.outside} == set(NAMED)
    assert len(NAMED) == len(CAUSES)
    assert set(version.single) == {c.name for c in CAUSES if c.library}
    assert len(version.outside) >= 12
    for every in VERSIONS.values():
        for one in every.values():
            assert {*one.together} <= {*one.single} <= {*version.single}
            assert {*one.outside} <= {*version.outside}
    assert {name for c in CAUSES for name in c.library} <= set(effects_by_name())
    kinds = Counter(version.kind(seed) for seed in range(100))
    assert kinds == {"single": 40, "none": 20, "outside": 20, "pair": 10, "triple": 10}
    for kind, names in (("single", version.single), ("outside", version.outside)):
        turns = Counter(
            version.turn(seed, kind) % len(names)
            for seed in range(200)
            if version.kind(seed) == kind
        )
        assert set(turns) == set(range(len(names)))


def test_a_lagging_joint_follows_a_ramp_late_by_its_time_constant():
    ramp = 2.0 * T[:, None] * np.ones(3)
    late = driven(T, ramp, Hand(lag=0.03))
    assert late == pytest.approx(
        2.0 * (T - 0.03 * (1 - np.exp(-T / 0.03)))[:, None] * np.ones(3), abs=1e-9
    )
    assert driven(T, ramp, Hand()) == pytest.approx(ramp)
    assert slid(T, Hand(slip=0.1, slip_from=0.2, slip_until=0.5))[-1] == pytest.approx(
        0.03
    )


def test_what_is_absent_of_clocks_and_camera_is_not_seen_and_what_is_there_has_its_sign(
    camera,
):
    def falling(times):
        return np.stack([0.5 + 0 * times, 0.6 - 2.0 * times], axis=-1)[:, None, :]

    times = np.linspace(0.1, 0.2, 5)
    plain = seen(falling, times, camera, Sight())
    assert plain == pytest.approx(falling(times), abs=1e-12)
    assert seen(falling, times, camera, Sight(offset=0.01)) == pytest.approx(
        falling(times + 0.01), abs=1e-12
    )
    assert seen(falling, times, camera, Sight(drift=0.1)) == pytest.approx(
        falling(1.1 * times), abs=1e-12
    )
    assert seen(falling, times, camera, Sight(scale=0.02)) == pytest.approx(
        1.02 * plain, abs=1e-12
    )
    rolled = seen(falling, times, camera, Sight(readout=0.01))
    # the row in which it is seen says when it was
    row = camera.pixels(rolled)[..., 1] / camera.height - 0.5
    assert rolled[:, 0] == pytest.approx(
        falling(times + 0.01 * row[:, 0])[:, 0], abs=1e-6
    )


def test_the_papers_parameters_are_the_rods():
    base = {
        "axial_stiffness": 6e5,
        "bending_stiffness": 5.0,
        "grasp_stiffness": 2.0,
        "linear_drag": 0.3,
    }
    base |= {
        "axial_damping": 30.0,
        "bending_damping": 5e-3,
        "grasp_damping": 5e-3,
        "quadratic_drag": 0.2,
    }
    assert Rod.of_points(0.3, **base).in_points() == pytest.approx(base)


def test_a_laboratory_whose_package_is_missing_says_which(monkeypatch):
    monkeypatch.setitem(sys.modules, "elastica", None)
    monkeypatch.delitem(
        sys.modules, "tests.benchmarks.simulators.laboratory.elastica", raising=False
    )
    with pytest.raises(
        DataError, match=r"laboratory=pyelastica needs elastica.*pip install pyelastica"
    ):
        laboratory.__wrapped__("pyelastica")


@pytest.mark.long
def test_the_same_seed_is_the_same_bench():
    """Once more, to the bit; and points are what hangs there within the noise."""
    one, again = drawn("nodal", 8), drawn("nodal", 8)
    assert one.truth == again.truth
    assert one.truth.kind == "triple"
    for points, same in zip(one.points, again.points, strict=True):
        assert np.array_equal(points, same)
    so = {
        name: value
        for cause in one.truth.causes
        for name, value in cause.settings.items()
    }
    true = one.scene.measured(one.scene.casts[0], so, FINE)
    assert np.std(one.points[0] - true) == pytest.approx(one.truth.sigma, rel=0.1)


@pytest.mark.long
def test_a_bench_is_trials_and_a_truth():
    trials, truth = bench("nodal", 8)
    assert 4 <= len(trials) <= 6
    assert len(truth.numerical_m) == len(trials)
    good = [
        error for name, error in truth.numerical_m.items() if name not in truth.chaotic
    ]
    assert max(good) < truth.sigma / 3
    assert truth.names == [NAMED[cause.name].library[0] for cause in truth.causes]
    assert min(cause.size_m for cause in truth.causes) >= 2.5e-3
