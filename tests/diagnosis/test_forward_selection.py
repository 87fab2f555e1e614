"""The diagnosis as a sum of single effects: its likelihood against dense algebra, and
causes hidden in a few casts.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from conftest import TRUTH, ordinary
from scipy.stats import cauchy, multivariate_normal

from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose.candidate_motions import DesignSettings
from stringcast.stages.diagnose.discrepancy_model import attach_discrepancy_model
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.diagnose.rules import is_supported
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.inference.discrepancy import (
    DISCREPANCY_SCALES_M,
    MEDIAN_SCALE_M,
    Discrepancy,
    _kernel_root,
    log_scale_prior,
    remove_smooth_motion,
)
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, evaluate_fit, fit_hypothesis
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.inference.solver import DIVERGED_RESIDUAL
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_exponents
from stringcast.stages.model.string import String
from tests.diagnosis.performed import CRITERIA, performed, swings

BASE = {
    **{
        "axial_stiffness": 5e5,
        "axial_damping": 30.0,
        "bending_stiffness": 3.0,
        "bending_damping": 0.005,
    },
    **{
        "linear_drag": 0.3,
        "quadratic_drag": 0.2,
        "grasp_stiffness": 1.0,
        "grasp_damping": 0.005,
    },
}


@pytest.fixture
def trial(arm, camera):
    """Four places of a string at rest in 25 frames: only times and places matter."""
    model, times = Model(String(0.3), arm, camera), np.arange(25) / 100
    frame, s = (
        a.ravel()
        for a in np.meshgrid(
            np.arange(25), 0.3 * np.array([0.25, 0.5, 0.75, 1.0]), indexing="ij"
        )
    )
    grasp = np.repeat([[0.1, 0.4, -np.pi / 2]], 25, axis=0)
    points, sigma = np.zeros((len(s), 2)), np.full(len(s), 5e-4)
    return PreparedTrial(
        "t", model, resample_hand_motion(times, grasp), times, frame, s, points, sigma
    )


@pytest.fixture
def lacking(trial):
    """What may be lacking in it, the beginning not known either; and the covariance of
    its residuals at each size.
    """
    growth, rng = np.linspace(0.2, 1.0, 25), np.random.default_rng(0)
    nuisance = rng.standard_normal((2 * len(trial.s), 3))
    root = np.kron(_kernel_root(trial, growth), np.eye(2))
    known = np.eye(len(root)) + nuisance @ nuisance.T
    return Discrepancy.for_trial(trial, growth, nuisance), [
        known + size**2 * root @ root.T for size in DISCREPANCY_SCALES_M
    ]


def test_coefficients_are_as_likely_as_a_dense_covariance_says(lacking):
    one, covariances = lacking
    told = one.coefficients(np.eye(len(covariances[0])))  # the map itself
    residual = np.random.default_rng(1).standard_normal((2, len(told)))
    said = one.log_likelihood_by_scale(one.coefficients(residual))
    for number in (0, 6, 12):
        dense = told.T @ covariances[number] @ told
        normal = multivariate_normal(np.zeros(len(dense)), dense)
        expected = normal.logpdf(residual @ told) + len(dense) / 2 * np.log(2 * np.pi)
        assert said[:, number] == pytest.approx(expected, rel=1e-6)


def test_white_coefficients_are_white(lacking):
    one, covariances = lacking
    told = one.coefficients(np.eye(len(covariances[0])))
    white = one.whiten_coefficients(told, 8)
    assert white.T @ covariances[8] @ white == pytest.approx(
        np.eye(white.shape[1]), abs=1e-6
    )


def test_sizes_of_what_is_lacking_are_half_cauchy():
    assert np.exp(log_scale_prior()).sum() == pytest.approx(1.0)
    edge = np.sqrt(DISCREPANCY_SCALES_M[9] * DISCREPANCY_SCALES_M[10])
    assert np.exp(log_scale_prior())[:10].sum() == pytest.approx(
        cauchy.cdf(edge / MEDIAN_SCALE_M) * 2 - 1
    )


def test_noise_is_told_beside_motion_however_large(trial):
    rng, times = np.random.default_rng(2), np.arange(100) / 200
    frame, s = (
        a.ravel() for a in np.meshgrid(np.arange(100), trial.s[:4], indexing="ij")
    )
    trial = replace(trial, times=times, frame=frame, s=s)
    swing = 40 * np.sin(12 * trial.times[trial.frame]) * trial.s / 0.3
    beside, noise = remove_smooth_motion(
        trial, swing[:, None] + 1.5 * rng.standard_normal((len(trial.s), 2))
    )
    assert noise == pytest.approx(1.5, rel=0.1)
    assert np.abs(beside).max() < 6


@pytest.mark.parametrize(("heavy", "believed"), [((1, 1, 1), True), ((1, 0, 0), False)])
def test_what_one_trial_says_alone_is_asked_of_the_others(arm, heavy, believed):
    """heavy: in which trials something hangs at the tip. The first says all for it, the
    others speak against the fit that it took along; fitted to them alone it is there,
    or it is not.
    """
    base = Hypothesis(with_second_order_mesh(ordinary(arm)))
    heavier = base.with_cause(effects_by_name()["tip_mass"])
    rng, places = np.random.default_rng(0), np.array([8, 14, 20])
    pairs = enumerate(zip(heavy, swings(arm, 3, 0.3), strict=True))
    masses = [
        (f"t{k}", {**TRUTH, "tip_mass.ratio": 0.1 * there}, angles)
        for k, (there, angles) in pairs
    ]
    observed = [
        performed(name, arm, heavier.model, own, angles, places, rng)
        for name, own, angles in masses
    ]
    chi = parameter_exponents(
        base.parameters, np.array([TRUTH[p.name] for p in base.parameters])
    )
    data = attach_discrepancy_model(
        [prepare_trial(base.model, each) for each in observed], base, chi
    )
    parent = fit_hypothesis(data, base, chi[None], np.full(3, 9))
    best = evaluate_fit(
        data,
        heavier,
        parameter_exponents(heavier.parameters, np.array(base_values(heavier, 0.1))),
    )
    said = np.array([623.0, -36.0, -75.0])
    best = replace(
        best,
        log_likelihood_by_trial=parent.log_likelihood_by_trial + said,
        log_evidence=parent.log_evidence + said.sum(),
    )
    assert is_supported(data, parent, best, CRITERIA) is believed


def base_values(hypothesis, ratio):
    return [{**TRUTH, "tip_mass.ratio": ratio}[p.name] for p in hypothesis.parameters]


def test_a_trial_that_cannot_be_simulated_lacks_nothing_that_is_smooth(trial):
    """No parameter moves it: its fit is said to be lost, instead of an error of linear
    algebra.
    """
    one = Discrepancy.for_trial(trial, np.zeros(25), np.zeros((2 * len(trial.s), 0)))
    assert not one.variance.any()
    assert np.isfinite(
        one.log_likelihood_by_scale(
            one.coefficients(np.full((1, 2 * len(trial.s)), DIVERGED_RESIDUAL))
        )
    ).all()


def test_what_hardly_moves_the_tip_does_not_enter(trial):
    growth, none = np.ones(25), np.zeros((2 * len(trial.s), 0))
    data = TrialData(
        (replace(trial, error_model=Discrepancy.for_trial(trial, growth, none)),) * 3
    )
    hypothesis = Hypothesis(trial.model)
    still = tuple(np.zeros(2 * len(trial.s)) for _ in range(3))
    parent = Fit(
        hypothesis, np.zeros(8), still, (), np.zeros(3, dtype=int), np.zeros(3), 0.0
    )
    heavier = replace(
        parent,
        hypothesis=hypothesis.with_cause(effects_by_name()["tip_mass"]),
        log_likelihood_by_trial=np.full(3, 20.0),
        log_evidence=60.0,
    )
    far, near = (
        replace(heavier, residuals=tuple(each + off for each in still))
        for off in (10.0, 0.1)
    )
    assert is_supported(data, parent, far, CRITERIA)
    assert not is_supported(data, parent, near, CRITERIA)


def said_of(model, observations, monkeypatch, **asked):
    """The diagnosis with a small library."""
    few = ("tip_mass", "density_taper", "time_offset", "arm_lag", "wind", "resolution")
    monkeypatch.setattr(
        module, "effects_by_name", lambda: {e.name: e for e in find_effects(few)}
    )
    design = DesignSettings(
        motions=2, shortest=0.4, longest=0.8, alpha=150.0, before=0.05, after=0.1
    )
    matching = Matching(dilations=20, step_px=2, tip_step_px=3.0, delta_w=0.25)
    rest = {
        "starts": 2,
        "criteria": CRITERIA,
        "matching": matching,
        "design": design,
        **asked,
    }
    return module.diagnose(model, observations, {}, (), (), seed=0, **rest)


def casts(arm, camera, effects, values, segments=120):
    """Three casts of half a second, of a string whose mesh does not show: of 30
    segments it would, as 2 to 4 mm.
    """
    mesh = {
        "points": segments + 1,
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
        "largest_step": 0.015 / segments,
    }
    string = String(0.3, integrator=ImplicitLeapfrog(), **mesh)
    true, rng = (
        Model(string, arm, camera).with_effects(*find_effects(effects)),
        np.random.default_rng(3),
    )
    made, t = [], arm.tick * np.arange(90)
    places = [round(share * segments) for share in (0.27, 0.5, 0.77, 1.0)]
    for number, (first, second) in enumerate([(0.5, 0.3), (-0.4, 0.5), (0.6, -0.4)]):
        # faster, one of them is chaotic, and would be set aside
        swing = np.sin(np.pi * np.clip(t / 0.4, 0, 1)) ** 2
        angles = np.array([0.6, -0.5, 0.2]) + swing[:, None] * np.array(
            [first, second, 0.4]
        )
        made.append(
            performed(f"t{number}", arm, true, {**BASE, **values}, angles, places, rng)
        )
    return Model(String(0.3), arm, camera), made


def test_a_mass_that_is_hidden_at_the_tip_is_found_and_the_budget_adds_up(
    arm, camera, monkeypatch
):
    made = said_of(
        *casts(arm, camera, ["tip_mass"], {"tip_mass.ratio": 0.05}), monkeypatch
    )
    said = json.loads(made.finding["diagnosis"].iloc[0])
    assert (said["verdict"], [cause["effect"] for cause in said["causes"]]) == (
        "effect",
        ["tip_mass"],
    )
    mass = said["causes"][0]["parameters"]["tip_mass.ratio"]
    assert mass["low"] < 0.05 < mass["high"]
    assert mass["high"] - mass["low"] < 0.01
    squares = sum(entry["tip_rms_m"] ** 2 for entry in said["budget"])
    off = made.residuals.assign(
        off=lambda r: (r.x - r.base_x) ** 2 + (r.y - r.base_y) ** 2
    )
    tip = off[off.s > off.s.max() - 1e-3].groupby("trial")["off"].mean().mean()
    assert squares == pytest.approx(tip, rel=1e-6)
    assert (
        said["gain"]["tip_rms_m"]["extended"] < 0.6 * said["gain"]["tip_rms_m"]["base"]
    )
    known = yaml.safe_load(made.finding["extended"].iloc[0])
    assert known["effects"] == ["tip_mass"]
    assert (
        known["parameter_values"]["tip_mass.ratio"]["low"]
        < 0.05
        < known["parameter_values"]["tip_mass.ratio"]["high"]
    )
    # how it entered: in every trial, and by as much as the residuals become less
    by_trial = made.entries.groupby("trial")[["log_likelihood", "evidence"]].first()
    assert set(made.entries["cause"]) == {"tip_mass"}
    assert [*by_trial.index] == ["t0", "t1", "t2"]
    assert by_trial["log_likelihood"].sum() > by_trial["evidence"].iloc[0] > 20
    assert by_trial["evidence"].iloc[0] == pytest.approx(
        said["budget"][0]["log_evidence"], rel=0.01
    )
    off = made.residuals
    squares = [
        ((off[["x", "y"]].to_numpy() - off[[f"{m}_x", f"{m}_y"]].to_numpy()) ** 2).sum(
            axis=1
        )
        for m in ("base", "extended")
    ]
    gone = (made.entries["before"] ** 2 - made.entries["after"] ** 2).mean()
    assert gone == pytest.approx((squares[0] - squares[1]).mean(), rel=0.05)


def test_a_cause_that_cannot_be_at_work_is_no_candidate(arm, camera, monkeypatch):
    made = said_of(
        *casts(arm, camera, ["tip_mass"], {"tip_mass.ratio": 0.05}),
        monkeypatch,
        excluded_effects=["tip_mass"],
    )
    assert not made.hypotheses["causes"].str.contains("tip_mass").any()


def test_a_string_without_any_is_left_alone(arm, camera, monkeypatch):
    model, observations = casts(arm, camera, [], {})
    fine = replace(
        model, string=replace(model.string, points=57, tip_cell=0.5, grasp_cell=0.5)
    )
    made = said_of(fine, observations, monkeypatch)
    assert made.verdict == "none"
    assert (
        json.loads(made.finding["diagnosis"].iloc[0])["unexplained"]["tip_rms_m"][
            "high"
        ]
        < CRITERIA.tip_tolerance_m
    )


@pytest.mark.parametrize(
    "true", [{"tip_mass.ratio": 0.05}, {"tip_mass.ratio": 0.05, "wind.along_x": 0.8}]
)
def test_one_trial_names_nothing_but_says_all_that_it_would(
    arm, camera, monkeypatch, true
):
    names = {name.split(".")[0] for name in true}
    model, observations = casts(arm, camera, sorted(names), true)
    said = json.loads(
        said_of(model, observations[2:], monkeypatch).finding["diagnosis"].iloc[0]
    )
    assert (said["verdict"], said["causes"]) == ("insufficient", [])
    assert {
        each["effect"] for each in said["alternatives"] if each["probability"] > 0.5
    } == names
    assert all(name in said["unexplained"]["sentence"] for name in names)


def test_a_cause_that_is_in_no_library_is_unknown(arm, camera, monkeypatch):
    model, observations = casts(arm, camera, ["wind"], {"wind.along_x": 2.0})
    made = said_of(model, observations, monkeypatch, excluded_effects=["wind"])
    assert (made.verdict, len(made.causes)) == ("unknown", 0)
    assert yaml.safe_load(made.finding["extended"].iloc[0])["effects"] == []
