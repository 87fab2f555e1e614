"""The noise floor of data as trackers tell them: in whole pixels, held at rest, and each point at a time of its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.noise import (
    alongside,
    cleaned,
    estimated,
    mismatch,
    rounding,
    scattered,
    systematic,
    tracks,
)
from stringcast.stages.inference.forward import Case

S = np.linspace(0.1, 0.3, 5)
T = np.arange(0, 1.5, 0.005)


def seen(points, late=0.0, sigma=1e-3):
    """Evidence of one trial. points: (F, S, 2) [m]. late: by what each point is later than the one before it [s]."""
    t = (T[:, None] + late * np.arange(len(S))).ravel()
    order = np.argsort(t, kind="stable")
    times, frame = np.unique(t[order], return_inverse=True)
    where = np.tile(S, len(T))[order]
    flat = points.reshape(-1, 2)[order]
    return Evidence((Case("t", None, None, times, frame, where, flat, np.full(len(flat), sigma)),), (10,)), order


def moving(noise, seed=0):
    """Points that swing for half of the time and then rest, (F, S, 2) [m], and the noise in them."""
    swing = np.where(T < 0.75, np.sin(8 * np.pi * T / 3), 0.0)[:, None, None] * S[:, None] * np.array([1.0, 0.3])
    error = noise * np.random.default_rng(seed).standard_normal(swing.shape)
    return swing + error, error


def test_points_told_in_steps_have_the_noise_of_rounding():
    """Half of the frames show the same rounded point again and again; of these nothing is learned."""
    true, _ = moving(0.0)
    step = 1e-3
    rounded = np.round(true / step) * step
    evidence, order = seen(rounded)
    assert rounding(evidence) == pytest.approx(step / np.sqrt(12), rel=1e-6)
    residual = ((rounded - true).reshape(-1, 2)[order] / 1e-3).ravel()
    assert estimated(evidence, residual) * 1e-3 == pytest.approx(step / np.sqrt(12), rel=0.35)


def test_what_is_not_told_in_steps_has_its_own_noise():
    points, error = moving(7e-4)
    evidence, order = seen(points)
    assert rounding(evidence) < 1e-5
    assert estimated(evidence, (error.reshape(-1, 2)[order] / 1e-3).ravel()) == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("late", [0.0, 4e-4])
def test_points_with_a_time_of_their_own_have_neighbours_all_the_same(late):
    """As rows of a rolling shutter have."""
    points, error = moving(7e-4)
    evidence, order = seen(points, late)
    lacking = 3e-3 * np.sin(4 * np.pi * T)[:, None, None] * np.ones(2) + error
    residual = (lacking.reshape(-1, 2)[order] / 1e-3).ravel()
    assert estimated(evidence, residual) == pytest.approx(0.7, rel=0.05)
    assert systematic(evidence, residual) == pytest.approx(3.0**2 / 2, rel=0.1)


@pytest.mark.parametrize("kind", ["wandering", "dense", "occluded"])
def test_places_need_not_be_the_same_in_every_frame(kind):
    """A traced line has points where it has them, some closer than a millimetre, and frames lack some: what the model
    lacks must not be taken for noise."""
    rng = np.random.default_rng(1)
    grid = np.linspace(0.02, 0.3, 600 if kind == "dense" else 15)
    frame, s = np.repeat(np.arange(len(T)), len(grid)), np.tile(grid, len(T))
    if kind == "wandering":
        s = s + np.repeat(rng.uniform(-0.01, 0.01, len(T)), len(grid))
    elif kind == "occluded":
        there = rng.random(len(s)) < 0.5
        frame, s = frame[there], s[there]
    lacking = 3e-3 * np.sin(4 * np.pi * T[frame] + 5 * s)[:, None] * np.ones(2)
    off = lacking + 7e-4 * rng.standard_normal((len(s), 2))
    evidence = Evidence((Case("t", None, None, T, frame, s, off, np.full(len(s), 1e-3)),), (10,))
    assert estimated(evidence, off.ravel() / 1e-3) == pytest.approx(0.7, rel=0.05)
    assert systematic(evidence, off.ravel() / 1e-3) == pytest.approx(3.0**2 / 2, rel=0.1)


def test_what_a_bad_model_leaves_is_not_taken_for_outliers():
    """A string that whips away from where a model has it goes far from frame to frame, and all of it goes."""
    rng = np.random.default_rng(2)
    s, frame = np.tile(S, len(T)), np.repeat(np.arange(len(T)), len(S))
    whip = 0.2 * np.where(np.abs(T - 0.5) < 0.008, 1.0, 0.0)[frame][:, None] * s[:, None] * np.ones(2)
    off = whip + 0.05 * np.sin(9 * T[frame])[:, None] + 7e-4 * rng.standard_normal((len(s), 2))
    wrong = rng.choice(len(s), 8, replace=False)
    off[wrong] += 0.04
    evidence = Evidence((Case("t", None, None, T, frame, s, off, np.full(len(s), 1e-3)),), (10,))
    kept, count = cleaned(evidence, off.ravel() / 1e-3)
    assert count == len(wrong)
    assert not set(map(tuple, off[wrong])) & set(map(tuple, kept.cases[0].points))


def test_noise_that_lasts_for_some_frames_or_is_that_of_a_whole_frame_is_no_mismatch():
    """As trackers make that follow a point from frame to frame, or light that flickers. A string that is elsewhere is
    so for some frames and beside that place."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal((len(T), len(S), 2))
    lasting = lfilter([np.sqrt(1 - 0.5**2)], [1, -0.5], white, axis=0)
    flickering = np.sqrt(0.5) * (white + rng.standard_normal((len(T), 1, 2)))
    bent = white + np.sin(6 * T)[:, None, None] * S[:, None] / 0.2
    found = {}
    for name, residual in {"lasting": lasting, "flickering": flickering, "bent": bent}.items():
        evidence, _ = seen(np.zeros(residual.shape))
        found[name] = systematic(evidence, residual.ravel()), alongside(evidence, residual.ravel())
        assert (mismatch(evidence, residual.ravel()) > 0) == (name == "bent")
    assert found["lasting"] == pytest.approx((0.5, 0.0), abs=0.08)
    assert found["flickering"] == pytest.approx((0.0, 0.5), abs=0.08)
    assert min(found["bent"]) > 0.4


def test_outliers_are_found_among_points_of_no_place():
    """Where points are at other places in every frame, two may fall to the same one, which one of them then follows."""
    rng = np.random.default_rng(4)
    s = np.sort(np.linspace(0.02, 0.3, 15) + rng.uniform(-0.01, 0.01, (len(T), 15)), axis=1).ravel()
    frame = np.repeat(np.arange(len(T)), 15)
    off = 7e-4 * rng.standard_normal((len(s), 2))
    case = Case("t", None, None, T, frame, s, off, np.full(len(s), 1e-3))
    alone = np.setdiff1d(np.arange(len(s)), np.concatenate(list(tracks(case))))
    assert len(alone) > 20
    off[alone[:10]] += 0.03
    _, count = cleaned(Evidence((case,), (10,)), off.ravel() / 1e-3)
    assert count == 10


@pytest.mark.parametrize("seed", range(4))
def test_a_trial_whose_points_are_scattered_is_told_and_not_emptied(seed):
    """A tip that a tracker lost, six frames of it beside trials that were followed well."""
    rng = np.random.default_rng(seed)
    evidence, _ = seen(moving(7e-4, seed)[1], sigma=7e-4)
    noise = evidence.cases[0].points.ravel() / 7e-4
    frames = np.arange(6)
    lost = Case("lost", None, None, frames / 30, frames, np.full(6, 0.3), np.zeros((6, 2)), np.full(6, 7e-4))
    both = replace(evidence, cases=(*evidence.cases, lost))
    astray = np.concatenate([noise, 0.05 / 7e-4 * rng.standard_normal(12)])
    assert scattered(both, np.concatenate([noise, rng.standard_normal(12)])) == []
    assert scattered(both, astray) == ["lost"]
    kept, _ = cleaned(both, astray)
    assert len(kept.cases[1].s) == 6
