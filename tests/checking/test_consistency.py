"""Measurements are judged by one model: mistakes are found, right ones left alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stringcast.pipeline.commands.import_geometry import option_words
from stringcast.stages.check.consistency.arm_place import base_corrections
from stringcast.stages.check.consistency.check import misfit_finding
from stringcast.stages.check.consistency.corrections import (
    change_joints,
    scale_all_times,
    scale_point_times,
)
from stringcast.stages.check.consistency.judge import judge, reason_beside_geometry
from stringcast.stages.check.consistency.limits import broken_limits
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.consistency.search import find_answer
from stringcast.stages.check.finding import Severity
from tests.checking.unusual_scenes import UNUSUAL, scene_measurements
from tests.importing.mistakes import simulated_bench


@pytest.fixture(scope="module")
def measured():
    return measurements_of(simulated_bench().with_tip_alone())


def measurements_of(bench):
    """Return what a bench measures, at places that are not stated."""
    recordings = []
    for number, ((t, joints), points) in enumerate(
        zip(bench.hands, bench.points, strict=True)
    ):
        tracks = tuple(Track(n, None, times, xy) for n, (times, xy) in points.items())
        recordings.append(Recording(f"t{number}", t, joints, None, tracks))
    return Measurements(tuple(recordings), bench.links, bench.base, bench.length)


SPOILT = {
    "joint order": lambda m: change_joints(m, lambda q: q[:, [0, 2, 1]]),
    "absolute": lambda m: change_joints(m, lambda q: np.cumsum(q, axis=1)),
    "rate": lambda m: scale_point_times(m, 2.0),
    "base": lambda m: replace(m, base=(m.base[0] + 0.3, m.base[1])),
    # links of a tenth would be possible, too, but fit ten times worse
    "base up": lambda m: replace(m, base=(m.base[0], m.base[1] + 0.3)),
    # with a stiffer string, and any offset of the clocks, these are possible
    "pace 2": lambda m: scale_all_times(m, 2.0),
    "pace 8": lambda m: scale_all_times(m, 8.0),
}
KINDS = {"joint order": "joint_order", "base up": "base"}


@pytest.mark.parametrize("mistake", SPOILT)
def test_a_mistake_has_one_answer(measured, mistake):
    spoilt = SPOILT[mistake](measured)
    (proposal,) = find_answer(spoilt, judge(spoilt)).proposals
    kind = KINDS.get(mistake, mistake.split()[0])
    assert [correction.kind for correction in proposal.corrections] == [kind]


def test_a_tip_that_rests_nearer_than_another_point_is_upside_down():
    """Without a length, longer strings with other clocks come near to such points."""
    right = replace(measurements_of(simulated_bench()), length=None)
    assert not broken_limits(right)

    def turn_over(track):
        return replace(track, xy=track.xy * [1.0, -1.0])

    wrong = right.with_tracks(turn_over)
    assert {limit.kind for limit in broken_limits(wrong).values()} == {"order"}
    (proposal,) = find_answer(wrong, judge(wrong)).proposals
    assert [correction.kind for correction in proposal.corrections] == ["y_down"]
    assert proposal.verdict.measured.length == pytest.approx(0.32, rel=0.05)


def test_a_base_that_the_motion_does_not_show_is_asked_for(measured):
    """Without a length, a longer string in a higher hand moves alike."""
    ((correction,),) = base_corrections(replace(measured, length=None), ())
    assert correction.values == ()
    assert "others up to" in correction.statement
    assert option_words(correction, None, None) == []  # no option of `import` states it


@pytest.mark.parametrize("shift", [(-0.12, 0.0), (0.2, 0.0), (0.1, 0.05)])
@pytest.mark.parametrize("is_stated", [False, True])
def test_a_doubtful_misfit_is_an_error_unless_the_geometry_was_measured(
    measured, shift, is_stated
):
    x, y = measured.base
    verdict = judge(replace(measured, base=(x + shift[0], y + shift[1])))
    assert 0.12 < verdict.misfit < 0.25
    metadata = {"geometry": "measured"} if is_stated else {}
    data = SimpleNamespace(metadata=metadata)
    dataset = SimpleNamespace(data=data, points_file="points.csv")
    finding = misfit_finding(dataset, verdict, ["t0"])
    assert finding.severity == (Severity.WARNING if is_stated else Severity.ERROR)
    assert is_stated or "--geometry-measured" in finding.remedy


def test_a_misfit_that_grows_from_a_right_beginning_is_a_warning():
    """At 5 m/s the string whips."""
    measured = scene_measurements("own_kernel", 2, speed=5.0)
    verdict = judge(measured)
    assert not verdict.is_consistent
    assert "whips" in reason_beside_geometry(verdict)
    assert not find_answer(measured, verdict).proposals


@pytest.mark.parametrize("seed", [0, 1, 4, 5])
def test_a_string_with_a_set_is_a_warning(seed):
    """It rests bent, in a hand that is where it seems."""
    measured = scene_measurements("own_kernel", seed, set_per_m=-5.0)
    verdict = judge(measured)
    assert not verdict.is_consistent
    assert "rests bent" in reason_beside_geometry(verdict)
    assert not find_answer(measured, verdict).proposals


def test_a_right_pace_stays_though_slower_points_would_move_less():
    measured = scene_measurements("own_kernel", 3)
    assert not find_answer(measured, judge(measured)).proposals


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
