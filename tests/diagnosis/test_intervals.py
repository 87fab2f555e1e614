"""What is said of a parameter that was found: its value, and how sure it is."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from test_parts_of_a_diagnosis import S, base, measured, resolved

from stringcast.stages.diagnose import sharpen
from stringcast.stages.diagnose.fit import PRIOR, Fit, fitted
from stringcast.stages.diagnose.intervals import half_width
from stringcast.stages.diagnose.resolve import SEGMENTS, finer
from stringcast.stages.diagnose.sharpen import Sharp, sharpened
from stringcast.stages.diagnose.theory import Theory, joined
from stringcast.stages.model.library import library


@pytest.fixture(scope="module")
def model(arm):
    return resolved(ordinary(arm))


@pytest.mark.parametrize("frames", [1, 5])
def test_of_a_hundred_intervals_ninety_five_hold_what_is_true(arm, model, frames):
    """Noise that lasts for some frames, and slopes that do: straight models, fitted 300 times each. As if all points
    were independent, no more than 34 in 100 would, and 15."""
    evidence, rng = measured(arm, model), np.random.default_rng(1)
    theory, count, lasting = Theory(model, (), model.names), len(evidence.trial), 2 * len(S) * frames
    slopes = 100 * rng.standard_normal((-(-count // lasting), len(theory.free))).repeat(lasting, axis=0)[:count]
    covariance = np.linalg.inv(slopes.T @ slopes + PRIOR * np.eye(len(theory.free)))
    inside, naive = [], []
    for _ in range(300):
        noise = rng.standard_normal(-(-count // lasting)).repeat(lasting)[:count]
        off = -covariance @ slopes.T @ noise
        fit = Fit(theory, theory.start, noise + slopes @ off, slopes)
        inside.append(np.abs(off) < half_width(evidence, fit))
        naive.append(np.abs(off) < 1.96 * np.sqrt(np.diag(covariance)))
    assert 0.9 < np.mean(inside) < 0.98
    assert np.mean(naive) < 0.4


@pytest.mark.parametrize(("name", "value"), [("tip_mass.ratio", 0.05), ("nonlinear_bending.hardening", 1e-4)])
def test_more_mass_points_take_a_value_to_where_it_belongs(arm, model, name, value):
    """A string of 81 points, fitted with 11 and 15: what nobody sees in any point moves a value all the same."""
    evidence = measured(arm, model, {name: value}, noise=1e-5)
    theory = joined(base(model, evidence).theory, library()[name.split(".")[0]])
    fit = fitted(evidence, [theory], [theory.at({**TRUTH, name: value})], 15)[0]
    sharp, place = sharpened(evidence, fit), theory.model.names.index(name)
    true = float(theory.model.parameters[place].chi(np.asarray(value)))
    assert abs(sharp.fit.chi[place] - true) < abs(fit.chi[place] - true) / 4
    low, high = (ends[list(theory.free).index(place)] for ends in sharp.interval(evidence))
    assert low < true < high


def test_shorter_steps_take_a_value_to_where_it_belongs(arm, model):
    """A string in steps of 0.1 ms, fitted with as many mass points in steps of 2 ms: the tip seems heavier, by what
    moves no point by a quarter of the noise."""
    real = replace(model, string=replace(model.string, largest_step=1e-4))
    long = replace(model, string=replace(model.string, largest_step=2e-3))
    evidence = replace(measured(arm, real, {"density_taper.taper": 0.1}, noise=1e-5), segments=(80,))
    theory = joined(Theory(long, (), long.names), library()["density_taper"])
    fit = fitted(evidence, [theory], [theory.at({**TRUTH, "density_taper.taper": 0.1})], 15)[0]
    sharp, place = sharpened(evidence, fit), theory.model.names.index("density_taper.taper")
    true = float(theory.model.parameters[place].chi(np.asarray(0.1)))
    assert np.abs(fit.residual).max() < 0.25
    assert abs(sharp.fit.chi[place] - true) < abs(fit.chi[place] - true) / 8


@pytest.mark.parametrize(("segments", "times"), [((10, 14), 4), ((20, 28), 2), ((40, 56), 2), ((9,), 4)])
def test_what_never_stays_is_made_finer_so_often_and_no_more(arm, model, monkeypatch, segments, times):
    """Beyond 40 segments a round takes a minute; equal points as they are stay as many as they are."""
    evidence, theory = replace(measured(arm, model, trials=1), segments=segments), Theory(model, (), model.names)
    asked, far = [], np.ones(len(theory.free))
    monkeypatch.setattr(sharpen, "_sharper", lambda evidence, fit: asked.append(evidence.segments) or Sharp(fit, far))
    sharpened(
        evidence, Fit(theory, theory.at(TRUTH), np.zeros(len(evidence.trial)), np.zeros((len(evidence.trial), 8)))
    )
    assert len(asked) == times


def test_however_many_mass_points_there_are_some_are_nearer_to_each_other():
    """Half as far apart after two of them: what the last of these changes is never nothing because there was none."""
    for few, more in SEGMENTS:
        assert finer(finer((few, more)))[0] == 2 * few
    assert [finer(pair) for pair in SEGMENTS[:-1]] == list(SEGMENTS[1:])
    assert finer((9,)) == (9,)


def test_what_mass_points_still_change_makes_an_interval_wider(arm, model):
    evidence, theory = measured(arm, model), Theory(model, (), model.names)
    fit = fitted(evidence, [theory], [theory.at(TRUTH)], 2)[0]
    half, far = half_width(evidence, fit), np.full(len(theory.free), 0.03)
    narrow, wide = (np.diff(Sharp(fit, doubt).interval(evidence), axis=0)[0] for doubt in (0 * far, far))
    within = (fit.chi[theory.free] > 0.2) & (fit.chi[theory.free] < 0.8) & (half < 0.1)
    assert within.sum() > 3
    np.testing.assert_allclose(narrow[within], 2 * half[within])
    np.testing.assert_allclose(wide[within], 2 * np.hypot(half, far)[within])
