"""Measurements are judged by a rough model, which finds only real mistakes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from stringcast.pipeline.commands.import_corrections import option_words
from stringcast.stages.check.consistency import search
from stringcast.stages.check.consistency.arm_place import ArmElsewhere, base_corrections
from stringcast.stages.check.consistency.check import misfit_finding
from stringcast.stages.check.consistency.corrections.directions import YDown
from stringcast.stages.check.consistency.corrections.joints import (
    AbsoluteAngles,
    JointOrder,
    change_joints,
)
from stringcast.stages.check.consistency.corrections.times import (
    PACES,
    Pace,
    PointRate,
    scale_all_times,
    scale_point_times,
)
from stringcast.stages.check.consistency.judge import (
    Verdict,
    judge,
    reason_beside_geometry,
)
from stringcast.stages.check.consistency.limits import Limit, broken_limits
from stringcast.stages.check.consistency.prediction import STIFFNESS_LADDER, ladder
from stringcast.stages.check.consistency.record import Measurements, Recording, Track
from stringcast.stages.check.consistency.search import find_answer
from stringcast.stages.check.finding import Severity
from stringcast.stages.common import GRAVITY_M_S2
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from tests.checking.unusual_scenes import UNUSUAL, scene_measurements
from tests.importing.mistakes import simulated_bench

# between hand and first point is half a segment, twice as stiff as a whole one
SOFT_AND_CLAMPED = {
    "bending_stiffness": 12.0,
    "bending_damping": 0.05,
    "grasp_stiffness": 24.0,
    "grasp_damping": 0.1,
    "axial_stiffness": 6e5,
    "axial_damping": 30.0,
    "linear_drag": 0.1,
    "quadratic_drag": 0.4,
}


@pytest.fixture(scope="module")
def measured():
    return measurements_of(simulated_bench().with_tip_alone())


def measurements_of(bench):
    """Return the measurements of a simulator, without arc lengths."""
    recordings = []
    for number, ((t, joints), points) in enumerate(
        zip(bench.hands, bench.points, strict=True)
    ):
        tracks = tuple(Track(n, None, times, xy) for n, (times, xy) in points.items())
        recordings.append(Recording(f"t{number}", t, joints, None, tracks))
    return Measurements(tuple(recordings), bench.links, bench.base, bench.length)


MISTAKES = {
    "joint order": (JointOrder, lambda m: change_joints(m, lambda q: q[:, [0, 2, 1]])),
    "absolute": (
        AbsoluteAngles,
        lambda m: change_joints(m, lambda q: np.cumsum(q, axis=1)),
    ),
    "rate": (PointRate, lambda m: scale_point_times(m, 2.0)),
    "base": (ArmElsewhere, lambda m: replace(m, base=(m.base[0] + 0.3, m.base[1]))),
    # links of a tenth would be possible, but fit ten times worse
    "base up": (ArmElsewhere, lambda m: replace(m, base=(m.base[0], m.base[1] + 0.3))),
    # with a stiffer string and another clock offset, these are possible
    "pace 2": (Pace, lambda m: scale_all_times(m, 2.0)),
    "pace 8": (Pace, lambda m: scale_all_times(m, 8.0)),
}


def correction_classes(proposal):
    return [type(correction) for correction in proposal.corrections]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_has_one_correction(measured, mistake):
    correction, spoil = MISTAKES[mistake]
    spoilt = spoil(measured)
    (proposal,) = find_answer(spoilt, judge(spoilt)).proposals
    assert correction_classes(proposal) == [correction]


def test_a_tip_that_rests_nearer_than_another_point_is_upside_down():
    """Without a length, longer strings with other clocks nearly fit such points."""
    right = replace(measurements_of(simulated_bench()), length=None)
    assert not broken_limits(right)

    def turn_over(track):
        return replace(track, xy=track.xy * [1.0, -1.0])

    wrong = right.with_tracks(turn_over)
    assert {broken.limit for broken in broken_limits(wrong).values()} == {Limit.ORDER}
    (proposal,) = find_answer(wrong, judge(wrong)).proposals
    assert correction_classes(proposal) == [YDown]
    assert proposal.verdict.measured.length == pytest.approx(0.32, rel=0.05)


def test_a_base_of_wrong_sign_or_order_is_corrected_exactly(measured):
    """The stated numbers are more precise than a base fitted to the motion."""
    x, y = measured.base
    for stated in ((-x, y), (x, -y), (y, x)):
        ((correction,),) = base_corrections(replace(measured, base=stated), ())
        assert correction.place == (x, y)
        assert "wrong sign or order" in correction.statement


def test_a_base_that_the_motion_does_not_determine_is_requested(measured):
    """Without a length, a longer string in a higher hand moves in the same way."""
    x, y = measured.base
    elsewhere = replace(measured, length=None, base=(x, y + 0.2))
    ((correction,),) = base_corrections(elsewhere, ())
    assert not correction.is_shown
    assert "others up to" in correction.statement
    assert option_words(correction, None, None) == []  # `import` has no option for it


@pytest.mark.parametrize("shift", [(-0.12, 0.0), (0.2, 0.0), (0.1, 0.05)])
@pytest.mark.parametrize("is_stated", [False, True])
def test_a_doubtful_misfit_is_an_error_unless_the_geometry_was_measured(
    measured, shift, is_stated
):
    x, y = measured.base
    verdict = judge(replace(measured, base=(x + shift[0], y + shift[1])))
    assert 0.12 < verdict.misfit < 0.25
    dataset = SimpleNamespace(geometry_is_measured=is_stated, points_file="points.csv")
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


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (4, 5))]
)
def test_a_string_with_a_set_is_a_warning(seed):
    """It is bent at rest; the hand is right."""
    measured = scene_measurements("own_kernel", seed, set_per_m=-5.0)
    verdict = judge(measured)
    assert not verdict.is_consistent
    assert "rests bent" in reason_beside_geometry(verdict)
    assert not find_answer(measured, verdict).proposals


def test_a_right_pace_is_kept_although_slower_points_move_less():
    measured = scene_measurements("own_kernel", 3)
    assert not find_answer(measured, judge(measured)).proposals


def test_a_soft_string_in_a_clamp_needs_no_correction():
    """It leaves the hand in the hand's direction and hangs after a few centimetres.

    Strings in compliant grasps hang elsewhere, as if the arm had another base.
    """
    clamped = measurements_of(simulated_bench(SOFT_AND_CLAMPED))
    verdict = judge(clamped)
    assert verdict.misfit < 0.04
    assert not find_answer(clamped, verdict).proposals


def test_the_ladder_contains_the_rest_shape_of_a_soft_string_in_a_clamp():
    """A beam with the stiffness of a rung is clamped in a tilted hand.

    At rest, the potential energy of N rigid pieces is least:

        V / m = g sum_k y_k + EI / (lambda l^2) sum_k (a_k - a_{k-1})^2 / 2,

    with pieces of length l and mass m, and half a piece from the clamp to a hinge.
    """
    length, segments, direction = 0.3, 60, -0.4
    piece = length / segments
    bending = 4.0 * 0.03**2  # EI / lambda [m4/s2] of the rung of 4.0
    hinge = np.full(segments, bending / piece**2)
    hinge[0] *= 2

    def energy(angles):
        turns = np.diff(angles, prepend=direction)
        heights = piece * np.cumsum(np.sin(angles))
        return GRAVITY_M_S2 * heights.sum() + 0.5 * hinge @ turns**2

    angles = minimize(energy, np.full(segments, -1.2)).x
    tip = piece * np.array([np.cos(angles).sum(), np.sin(angles).sum()])

    string, rungs = ladder(length, 0.0)
    t = np.array([0.0, 0.005])
    hand = resample_hand_motion(t, np.tile([0.0, 0.0, direction], (2, 1)))
    tips = simulate(string, hand, rungs, t).points[:, 0, -1]
    apart_m = np.linalg.norm(tips - tip, axis=1)
    clamped = STIFFNESS_LADDER.index((4.0, 8.0))
    assert apart_m.argmin() == clamped
    assert apart_m[clamped] < 0.01 * length


def test_a_measured_place_of_the_arm_is_not_fitted(measured):
    x, y = measured.base
    elsewhere = replace(measured, base=(x + 0.1, y + 0.05))
    answer = find_answer(elsewhere, judge(elsewhere))
    assert [correction_classes(p) for p in answer.proposals] == [[ArmElsewhere]]
    stated = replace(elsewhere, base_is_measured=True)
    assert not find_answer(stated, judge(stated)).proposals


def test_right_data_need_no_correction(measured):
    verdict = judge(measured)
    assert verdict.is_consistent
    answer = find_answer(measured, verdict)
    assert not answer.proposals
    assert not answer.pairing


@pytest.mark.parametrize(("wrong_frames", "is_broken"), [(2, False), (10, True)])
def test_outliers_in_the_first_frames_do_not_break_limits(
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
def test_unusual_but_right_geometry_is_not_corrected(kind, seed):
    measured = scene_measurements("nodal", seed, **UNUSUAL[kind])
    verdict = judge(measured)
    assert verdict.is_consistent, verdict.misfits
    answer = find_answer(measured, verdict)
    assert not answer.proposals
    assert not answer.pairing


@pytest.mark.parametrize(
    ("corrected_misfit", "is_proposed"), [(0.02, True), (0.1, False)]
)
def test_a_pace_must_explain_the_motion(corrected_misfit, is_proposed, monkeypatch):
    """A string that rests bent is as far from the prediction as it moves, at any pace.

    Points move by 0.06 lengths in the predicted time, and by 0.1 at four times the
    pace. So the misfit over the motion is smaller, although nothing is explained.
    """
    tip = Track("tip", 1.0, np.arange(3.0), np.zeros((3, 2)))
    recording = SimpleNamespace(
        name="t0", track=lambda point: tip, starts_moving=False, is_restless=False
    )
    given = SimpleNamespace(length=1.0, recordings=[recording], stated_arc_lengths=[])
    slow = SimpleNamespace(length=1.0, recordings=[recording], stated_arc_lengths=[1.0])
    before = Verdict(given, {}, {"t0": 0.11})
    after = Verdict(slow, {}, {"t0": corrected_misfit})
    motion = iter([0.06, 0.1])
    monkeypatch.setattr(search, "apply_corrections", lambda *_: slow)
    monkeypatch.setattr(search, "is_impossible", lambda *_: False)
    monkeypatch.setattr(search, "judge", lambda *_: after)
    monkeypatch.setattr(search, "farthest_point", lambda *_: "tip")
    monkeypatch.setattr(search, "mean_motion", lambda *_: next(motion))
    monkeypatch.setattr(search, "falls_at_its_pace", lambda *_: True)
    pace = next(p for p in PACES if p.factor == 4.0)
    found = search.consistent_proposals(given, before, [(pace,)])
    assert bool(found) == is_proposed
