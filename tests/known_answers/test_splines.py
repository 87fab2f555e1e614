"""Splines through samples are those of SciPy, which takes longer to import."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from stringcast.stages.model.hand import HandMotion, resample_hand_motion
from stringcast.stages.model.splines import natural_rates


@pytest.mark.parametrize("count", [2, 3, 60])
def test_natural_splines_are_those_of_scipy(count):
    rng = np.random.default_rng(count)
    t = 0.3 + np.cumsum(rng.uniform(0.001, 0.02, count))
    values = 0.1 * rng.standard_normal((4, count, 3))
    expected = CubicSpline(t, values, axis=1, bc_type="natural")
    assert natural_rates(t, values) == pytest.approx(expected(t, 1))
    motion = resample_hand_motion(t, values)
    assert motion.pose == pytest.approx(expected(motion.times))
    assert motion.rate == pytest.approx(expected(motion.times, 1))


def test_a_motion_between_its_poses_is_that_of_scipy():
    """Each candidate begins at another moment, one of them before the first pose."""
    rng = np.random.default_rng(0)
    pose, rate = rng.standard_normal((2, 4, 50, 3))
    motion = HandMotion(0.1, 0.005, pose, rate)
    begin = np.array([0.1, 0.1017, 0.2042, 0.0993])
    expected = CubicHermiteSpline(motion.times, pose, rate, axis=1)
    later = motion.starting_at(begin)
    for number, first in enumerate(begin):
        times = first + later.times
        moving = (times >= 0.1) & (times <= motion.end)
        assert moving.sum() > 20
        found = later.pose[number][moving], later.rate[number][moving]
        at = times[moving]
        assert found[0] == pytest.approx(expected(at)[number])
        assert found[1] == pytest.approx(expected(at, 1)[number], abs=1e-9)
