"""From trials to data: noise, outliers, ends at rest, trials that nobody can simulate,
ranges that end too early.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, ordinary
from performed import performed, swings

from stringcast.stages.diagnose.base_model import (
    MAX_SEARCH_ITERATIONS,
    widen_range_if_supported,
)
from stringcast.stages.diagnose.chaos import exclude_chaotic_trials
from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import (
    fit_mesh_correction,
    subtract_discretisation_error,
    with_second_order_mesh,
)
from stringcast.stages.diagnose.noise import (
    KEPT_REST_S,
    _remove_trial_outliers,
    reestimate_noise,
    trim_trailing_rest,
)
from stringcast.stages.diagnose.prepared_data import PreparedData
from stringcast.stages.inference.discrepancy import remove_smooth_motion
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import evaluate_fit
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.search import (
    refine_solution,
    screen_candidates,
    search_parameters,
)
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip
from stringcast.stages.model.parameter import parameter_exponents

SIGMA = 7e-4
S = np.linspace(0.1, 0.3, 5)
T = np.arange(0, 1.5, 0.005)
TOLERANCE = 2e-3  # [m]


@pytest.fixture(scope="module")
def model(arm):
    return with_second_order_mesh(ordinary(arm))


def trial(model, frame, s, off=None):
    """A trial of which only times and places matter, and where its points are, (n, 2)
    [m].
    """
    points = np.zeros((len(s), 2)) if off is None else off
    return PreparedTrial("t", model, None, T, frame, s, points, np.full(len(s), 1e-3))


@pytest.fixture(scope="module")
def observed(arm, model):
    """Three swings, as they would be measured."""
    rng, places = np.random.default_rng(0), np.array([8, 14, 20])
    return [
        performed(f"t{k}", arm, model, TRUTH, angles, places, rng)
        for k, angles in enumerate(swings(arm, 3, 0.3))
    ]


@pytest.mark.parametrize("kind", ["wandering", "dense", "occluded"])
def test_noise_is_told_from_what_a_model_lacks_wherever_points_are(model, kind):
    """A traced line has points where it has them, some closer than a millimetre, and
    frames lack some.
    """
    rng = np.random.default_rng(1)
    grid = np.linspace(0.02, 0.3, 600 if kind == "dense" else 15)
    frame, s = np.repeat(np.arange(len(T)), len(grid)), np.tile(grid, len(T))
    if kind == "wandering":
        s = s + np.repeat(rng.uniform(-0.01, 0.01, len(T)), len(grid))
    elif kind == "occluded":
        there = rng.random(len(s)) < 0.5
        frame, s = frame[there], s[there]
    lack = (
        3e-3
        * np.sin(4 * np.pi * T[frame] + 5 * s)[:, None]
        * s[:, None]
        / 0.3
        * np.ones(2)
    )
    off = lack + SIGMA * rng.standard_normal((len(s), 2))
    assert remove_smooth_motion(trial(model, frame, s), off / 1e-3)[1] == pytest.approx(
        0.7, rel=0.05
    )


def test_points_that_are_far_out_are_left_out_and_hardly_any_other(model):
    """However far the model itself is off. Smooth motion follows an outlier a little,
    and leaves its neighbours.
    """
    rng = np.random.default_rng(2)
    s, frame = np.tile(S, len(T)), np.repeat(np.arange(len(T)), len(S))
    off = 0.05 * np.sin(9 * T[frame])[:, None] * s[
        :, None
    ] / 0.3 + SIGMA * rng.standard_normal((len(s), 2))
    wrong = rng.choice(len(s), 8, replace=False)
    off[wrong] += 0.04
    kept, _, noise = _remove_trial_outliers(trial(model, frame, s, off), off / 1e-3)
    assert len(kept.s) > 0.95 * len(s)
    assert not set(map(tuple, off[wrong])) & set(map(tuple, kept.points))
    assert noise == pytest.approx(0.7, rel=0.1)


def test_a_trial_of_scattered_points_is_not_emptied(model):
    """A tip that a tracker lost, six frames of it."""
    frame, off = np.arange(6), 0.05 * np.random.default_rng(3).standard_normal((6, 2))
    lost = replace(trial(model, frame, np.full(6, 0.3), off), times=frame / 30)
    assert len(_remove_trial_outliers(lost, off / 1e-3)[0].s) == 6


def test_what_hangs_still_is_looked_at_once(model):
    times = np.arange(0, 10, 0.01)
    # within 3 mm of rest from about 3.5 s on
    swing = 0.1 * np.exp(-times) * np.cos(9 * times)
    points = np.stack(
        [np.outer(swing, np.linspace(0.1, 1, 5)), np.zeros((len(times), 5))], axis=-1
    ).reshape(-1, 2)
    ready = trial(
        model, np.repeat(np.arange(len(times)), 5), np.tile(S, len(times)), points
    )
    ready = replace(ready, times=times)
    last = times[np.flatnonzero(np.abs(swing) > 0.003)[-1]]
    kept = trim_trailing_rest(ready)
    assert kept.times[-1] == pytest.approx(last + KEPT_REST_S, abs=0.011)
    assert len(kept.points) == 5 * len(kept.times)
    # the rest that counts is that at the end, wherever the string was for most of the
    # time
    before = replace(
        ready, points=ready.points + 0.1 * (ready.times[ready.frame] < 6.0)[:, None]
    )
    assert trim_trailing_rest(before).times[-1] == pytest.approx(
        6.0 + KEPT_REST_S, abs=0.011
    )
    # a string that still moves at the end is left as it is, one that never moves is
    # looked at shortly
    assert len(
        trim_trailing_rest(replace(ready, points=ready.points * 1e3)).times
    ) == len(times)
    assert trim_trailing_rest(replace(ready, points=ready.points * 1e-3)).times[
        -1
    ] == pytest.approx(KEPT_REST_S, abs=0.011)


@pytest.fixture(scope="module")
def prepared(model, observed):
    trials, hypothesis = (
        tuple(prepare_trial(model, o) for o in observed),
        Hypothesis(model),
    )
    chi = parameter_exponents(
        hypothesis.parameters, np.array([TRUTH[p.name] for p in hypothesis.parameters])
    )
    data = attach_discrepancy_model(trials, hypothesis, chi)
    return PreparedData(
        data, evaluate_fit(data, hypothesis, chi), trials, trials, 0, np.zeros(3)
    )


@pytest.mark.parametrize(
    ("doubts", "chaotic"),
    [((0.1, 0.2, 0.3), ()), ((0.1, 5.0, 0.3), ("t1",)), ((0.1, 5.0, 5.0), ())],
)
def test_a_chaotic_trial_is_set_aside_while_two_others_are_left(
    prepared, doubts, chaotic
):
    """doubts: what is in doubt of each trial's numerical error, over what is tolerated."""
    kept = exclude_chaotic_trials(
        replace(prepared, discretisation_uncertainty_m=np.array(doubts) * TOLERANCE),
        TOLERANCE,
    )
    assert kept.chaotic_trials == chaotic
    assert {t.name for t in kept.data.trials} == {"t0", "t1", "t2"} - {*chaotic}
    assert len(kept.base_fit.residuals) == len(kept.trials) == 3 - len(chaotic)
    told = replace(
        prepared,
        discretisation_uncertainty_m=np.array(doubts) * TOLERANCE,
        keep_if_chaotic=("t0", "t1", "t2"),
    )
    assert exclude_chaotic_trials(told, TOLERANCE) is told


def test_what_a_poorer_model_took_for_outliers_is_looked_at_again(prepared):
    some = prepared.trials[0]
    parts = {
        name: getattr(some, name)[40:] for name in ("frame", "s", "points", "sigma")
    }
    poorer = replace(prepared, trials=(replace(some, **parts), *prepared.trials[1:]))
    assert poorer.outlier_count == 40
    reconsidered = reestimate_noise(poorer, prepared.base_fit)
    assert reconsidered.point_counts == prepared.point_counts


def test_a_search_is_not_taken_along_by_the_trial_that_another_string_made(arm, model):
    """Of four: three casts of one string, and one of a string four times as stiff."""
    rng, places, strings = np.random.default_rng(3), np.array([8, 14, 20]), [TRUTH] * 3
    strings.append(TRUTH | {"bending_stiffness": 4 * TRUTH["bending_stiffness"]})
    given = zip(strings, swings(arm, 4, 0.3), strict=True)
    cases = tuple(
        prepare_trial(model, performed(f"t{k}", arm, model, *each, places, rng))
        for k, each in enumerate(given)
    )
    likelihood = Likelihood(TrialData(cases), model)
    start = parameter_exponents(
        model.parameters, np.array([p.start for p in model.parameters])
    )
    tried = np.concatenate([start[None], rng.uniform(size=(64, len(start)))])
    _, chi = refine_solution(
        likelihood,
        search_parameters(
            likelihood, screen_candidates(likelihood, tried, 8), MAX_SEARCH_ITERATIONS
        ),
    )
    off = [
        np.sqrt(np.mean(each**2))
        for each in TrialData(cases).residuals(model, chi[None])
    ]
    assert max(off[:3]) < 1.1
    assert off[3] > 10


def test_a_range_that_ends_too_early_is_widened_where_the_data_press(model, prepared):
    narrow = replace(
        next(p for p in model.string.parameters if p.name == "bending_stiffness"),
        high=2.0,
    )
    ranges = {**model.string.ranges, "bending_stiffness": narrow}
    squeezed = replace(model, string=replace(model.string, ranges=ranges))
    likelihood = Likelihood(
        TrialData(tuple(replace(t, model=squeezed) for t in prepared.trials)), squeezed
    )
    bending, axial = (
        squeezed.names.index(name) for name in ("bending_stiffness", "axial_stiffness")
    )
    chi = np.clip(prepared.base_fit.chi, 0.1, 0.9)
    assert widen_range_if_supported(likelihood, chi, bending)[0] is likelihood
    chi[[bending, axial]] = 1.0
    # as good anywhere
    assert widen_range_if_supported(likelihood, chi, axial)[0] is likelihood
    wider, there = widen_range_if_supported(likelihood, chi, bending)
    assert wider.model.string.ranges["bending_stiffness"].high == pytest.approx(60.0)
    assert {n for n, p in wider.model.string.ranges.items() if p != ranges.get(n)} == {
        "bending_stiffness"
    }
    assert wider.parameters[bending].value(there[bending]) > 2.0


def test_numerical_error_is_followed_as_parameters_move(model, observed):
    """Strands that stick until a curvature of 0.02 /m, and 0.03: a coarse string slips
    elsewhere than a fine one.
    """
    hypothesis = Hypothesis(model.with_effects(MaxwellSlip))
    known = TRUTH | {"maxwell_slip.cap": 2e-3, "maxwell_slip.slip": 0.02}
    here, there = (
        parameter_exponents(hypothesis.parameters, hypothesis.model.values(each)[None])[
            0
        ]
        for each in (known, known | {"maxwell_slip.slip": 0.03})
    )
    raw = tuple(
        replace(prepare_trial(model, o), model=hypothesis.model) for o in observed
    )
    data, doubt = subtract_discretisation_error(raw, hypothesis, here)
    fit = evaluate_fit(data, hypothesis, here)
    made = PreparedData(data, fit, raw, raw, 0, doubt)
    true = np.hstack(
        [
            r[0]
            for r in subtract_discretisation_error(raw, hypothesis, there)[0].residuals(
                hypothesis.model, there[None]
            )
        ]
    )
    off = {}
    for name, finer in (
        ("as it was", None),
        ("followed", fit_mesh_correction(made, fit)),
    ):
        told = replace(data, mesh_correction=finer).residuals(
            hypothesis.model, there[None]
        )
        off[name] = np.sqrt(np.mean((np.hstack([r[0] for r in told]) - true) ** 2))
    assert off["followed"] < 0.5 * off["as it was"]
    assert off["as it was"] > 0.01  # deviations: there is something to follow
