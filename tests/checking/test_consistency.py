"""Measurements are judged by one model: mistakes are found, right ones left alone."""

from dataclasses import replace

import numpy as np
import pytest

from stringcast.stages.check.consistency.corrections import (
    change_joints,
    scale_point_times,
)
from stringcast.stages.check.consistency.judge import judge
from stringcast.stages.check.consistency.limits import broken_limits
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.consistency.search import find_answer
from tests.checking.unusual_scenes import UNUSUAL, scene_measurements
from tests.importing.mistakes import simulated_bench


@pytest.fixture(scope="module")
def measured():
    bench = simulated_bench().with_tip_alone()
    recordings = []
    for number, ((t, joints), points) in enumerate(
        zip(bench.hands, bench.points, strict=True)
    ):
        tracks = tuple(Track(n, None, times, xy) for n, (times, xy) in points.items())
        recordings.append(Recording(f"t{number}", t, joints, None, tracks))
    return Measurements(tuple(recordings), bench.links, bench.base, bench.length)


SPOILT = {
    "joint_order": lambda m: change_joints(m, lambda q: q[:, [0, 2, 1]]),
    "absolute": lambda m: change_joints(m, lambda q: np.cumsum(q, axis=1)),
    "rate": lambda m: scale_point_times(m, 2.0),
    "base": lambda m: replace(m, base=(m.base[0] + 0.3, m.base[1])),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_mistake_has_one_answer(measured, kind):
    spoilt = SPOILT[kind](measured)
    (proposal,) = find_answer(spoilt, judge(spoilt)).proposals
    assert [correction.kind for correction in proposal.corrections] == [kind]


def test_what_is_right_needs_no_answer(measured):
    verdict = judge(measured)
    assert verdict.is_consistent
    answer = find_answer(measured, verdict)
    assert not answer.proposals
    assert not answer.pairing


@pytest.mark.parametrize(("wrong_frames", "is_broken"), [(2, False), (10, True)])
def test_a_string_at_rest_may_have_outliers_among_its_first_frames(
    measured, wrong_frames, is_broken
):
    def move(track):
        xy = track.xy.copy()
        xy[:wrong_frames] += 2.0
        return replace(track, xy=xy)

    assert bool(broken_limits(measured.with_tracks(move))) == is_broken


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", UNUSUAL)
def test_unusual_but_right_geometry_is_left_alone(kind, seed):
    measured = scene_measurements("nodal", seed, **UNUSUAL[kind])
    verdict = judge(measured)
    assert verdict.is_consistent, verdict.misfits
    answer = find_answer(measured, verdict)
    assert not answer.proposals
    assert not answer.pairing
