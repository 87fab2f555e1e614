"""The clock offset of arm and camera, estimated from the motion."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT, measured_sample, simulated_points

from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.pipeline.commands.check import (
    overview_with_clocks,
    read_measurements,
    settings_for_data,
)
from stringcast.pipeline.commands.clock_fit import plain_model
from stringcast.stages.check.clocks import check_clock_interval, check_frame_rate
from stringcast.stages.check.consistency import trial_clocks
from stringcast.stages.check.consistency.prediction import WHOLE_MOTION
from stringcast.stages.check.consistency.trial_clocks import check_trial_clocks
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.measured import CheckedDataset, without_spikes
from stringcast.stages.clock import fit as clock_fit
from stringcast.stages.clock import offset
from stringcast.stages.clock.fit import model_with_offset
from stringcast.stages.clock.hidden_causes import average_by_evidence
from stringcast.stages.clock.offset import (
    ClockOffset,
    FittedOffset,
    estimate_clock_offset,
    find_wrong_clock,
    refuse_wrong_clock,
    wrong_clock_error,
)
from stringcast.stages.clock.windows import (
    Window,
    common_window,
    narrow_by_stretch,
    onset_window,
    possible_windows,
)
from stringcast.stages.diagnose.clocks import clock_offsets
from stringcast.stages.diagnose.clocks.clock_offsets import (
    MAX_SCALE_M,
    OFFSET,
    Interval,
    clock_posterior,
    explains_more,
    refit_with_one_offset,
    scatter_of_trials,
)
from stringcast.stages.diagnose.evidence.background_effects import (
    Background,
    BackgroundPosterior,
)
from stringcast.stages.inference.discrepancy_grid import DISCREPANCY_SCALES_M
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effects.tip_mass import TipMass

SAMPLE = ROOT / "data" / "sample"
MEASURED = ROOT.parent / "shared" / "measured" / "tudelft_cable_fr3"
CASE = ROOT.parent / "shared" / "cases" / "two_clocks"
CHECKED = measured_sample()
TRIALS = CHECKED.trials
FRAME_S = 0.005
MODEL = plain_model(CHECKED)


@pytest.fixture
def few_starts(monkeypatch):
    """Search strings from two starts instead of six, which saves about 14 % of time."""
    monkeypatch.setattr(clock_fit, "STARTS", 2)


def late(seen, by, tip_alone=True):
    """Return a trial whose camera's clock is ahead by some seconds."""
    points = seen.points
    points = points.groupby("t").tail(1) if tip_alone else points[points["s"] > 0.2]
    shifted = points.assign(t=points["t"] + by)
    return replace(seen, observation=replace(seen.observation, points=shifted))


@pytest.mark.parametrize("tip_alone", [True, False])
@pytest.mark.parametrize("by", [12.345, -7200.0])
def test_geometry_limits_the_offset_of_casts_to_a_few_frames(by, tip_alone):
    windows = possible_windows([late(seen, by, tip_alone) for seen in TRIALS])
    assert set(windows) == {seen.name for seen in TRIALS}
    (window,) = set(windows.values())
    assert window.low < -by < window.high
    assert window.high - window.low < 10 * FRAME_S


def test_each_trial_may_have_its_own_window():
    given = {"t00": 3.0, "t03": -5.0}
    windows = possible_windows(
        [late(seen, given[seen.name]) for seen in TRIALS if seen.name in given]
    )
    for name, by in given.items():
        assert windows[name].low < -by < windows[name].high


def test_a_string_that_something_else_moves_first_does_not_shift_the_window():
    windows = [onset_window(seen) for seen in TRIALS]
    early = windows[0]._replace(low=windows[0].low + 0.2, high=windows[0].high + 0.2)
    window = common_window([*windows[1:], early])
    assert window.low < 0 < window.high
    assert common_window([windows[0], early._replace(low=4.0, high=5.0)]) is None


@pytest.mark.parametrize("step", [20, 1000])
def test_outliers_do_not_narrow_a_window(step):
    seen = late(TRIALS[0], 0.0)
    points = seen.points.copy()
    points.iloc[10::step, points.columns.get_loc("x")] += 5.0
    dirty = replace(seen, observation=replace(seen.observation, points=points))
    window = onset_window(seen)
    assert onset_window(dirty) == window
    # one of many points is trimmed, even if it does not jump back
    used = dirty if step == 1000 else without_spikes(dirty)
    assert narrow_by_stretch([used], window) == pytest.approx(
        narrow_by_stretch([seen], window), abs=2 * FRAME_S
    )


def test_the_offset_of_a_string_that_never_moves_is_refused():
    seen = TRIALS[0]
    points = seen.points.assign(x=0.1, y=0.2)
    still = replace(seen, observation=replace(seen.observation, points=points))
    with pytest.raises(DataError, match="never begins to move"):
        possible_windows([still])


def test_the_estimated_offset_is_within_its_interval(few_starts, monkeypatch):
    """The interval contains the truth although the sample hides a cause."""
    # a fit that is needed only for a refusal
    monkeypatch.delattr(offset, "explained_by_offset")
    by = -35.678
    late_trials = [late(seen, by).observation for seen in TRIALS[:2]]
    found = estimate_clock_offset(MODEL, late_trials, np.random.default_rng(0))
    assert found.is_common
    assert found.drift is None
    interval = found.by_trial["t00"]
    assert interval.low < -by < interval.high
    assert interval.high - interval.low < 2 * FRAME_S
    # the profile is highest near the truth
    best = found.profile.loc[found.profile["log_likelihood"].idxmax(), "offset"]
    assert best == pytest.approx(-by, abs=FRAME_S)


def push_aside(observation, acceleration):
    """Push the string aside with an acceleration [m/s2] after 0.25 s."""
    points = observation.points
    since_onset_s = np.maximum(points["t"] - points["t"].min() - 0.25, 0.0)
    push_m = acceleration / 2 * since_onset_s**2 * points["s"] / points["s"].max()
    return replace(observation, points=points.assign(x=points["x"] + push_m))


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_an_unknown_disturbance_does_not_separate_clocks(seed):
    """The fit with one clock restarts from the string found with separate clocks.

    Without this, trials got separate clocks that were wrong by up to 290 ms.
    """
    accelerations = (4.0, 3.0, 3.6, 3.2)
    pushed = [
        push_aside(late(seen, 0.0, tip_alone=False).observation, acceleration)
        for seen, acceleration in zip(TRIALS, accelerations, strict=False)
    ]
    found = estimate_clock_offset(MODEL, pushed, np.random.default_rng(seed))
    assert found.is_common
    assert found.drift is None
    interval = found.by_trial["t00"]
    assert interval.low < 0 < interval.high


def late_by_trial(given_s):
    """Return trials of a sample whose camera's clock is ahead by some seconds."""
    trials = []
    for seen in TRIALS:
        if seen.name in given_s:
            trials.append(late(seen, given_s[seen.name], tip_alone=False).observation)
    return trials


@pytest.mark.long
def test_trials_with_separate_clocks_get_separate_offsets():
    given_s = {"t00": 0.0, "t01": 0.06, "t02": -0.04}
    trials = late_by_trial(given_s)
    found = estimate_clock_offset(MODEL, trials, np.random.default_rng(0))
    assert not found.is_common
    for name, by in given_s.items():
        interval = found.by_trial[name]
        assert interval.low < -by < interval.high
        assert interval.high - interval.low < 4 * FRAME_S


def with_slow_clock(rate):
    """Return two trials in which the arm's clock gains a rate on the camera's.

    Both agree at t = 0.
    """
    slow = []
    for seen in TRIALS[:2]:
        points = seen.points.assign(t=seen.points["t"] / (1 + rate))
        slow.append(replace(seen.observation, points=points))
    return slow


@pytest.mark.long
def test_the_drift_of_a_slow_clock_is_within_its_interval():
    slow = with_slow_clock(0.02)
    found = estimate_clock_offset(MODEL, slow, np.random.default_rng(0))
    assert found.drift.low < 0.02 < found.drift.high
    assert found.by_trial["t00"].low < 0.0 < found.by_trial["t00"].high


def test_a_wrong_frame_rate_is_refused(few_starts):
    """The camera's times are those of 200 frames per second instead of 240."""
    rate = 200 / 240 - 1
    wrong = find_wrong_clock(MODEL, with_slow_clock(rate), np.random.default_rng(0))
    assert wrong.drift.low < rate < wrong.drift.high
    assert wrong.by_trial["t00"].low < 0.0 < wrong.by_trial["t00"].high
    message = r"16\.\d % fast .* Give 1\.(19|20)\d times the rate"
    assert re.search(message, str(wrong_clock_error(wrong, "points.parquet")))


def clock_with(log_likelihoods, misfit_m):
    """Return a stand-in for a fit with log-likelihoods and misfits of trials."""
    by_trial = np.array(log_likelihoods)
    fit = SimpleNamespace(log_evidence=by_trial.sum(), log_likelihood_by_trial=by_trial)
    return SimpleNamespace(fit=fit, data=np.array(misfit_m))


@pytest.mark.parametrize(
    ("gains", "left_m", "is_believed"),
    [
        ((10.0, 10.0), (0.01, 0.01), True),
        ((10.0, 10.0), (0.08, 0.08), False),
        ((-10.0, -10.0), (0.01, 0.01), False),
        # one of several trials does not decide by its likelihood or misfit
        ((90.0, -10.0), (0.01, 0.01), False),
        ((90.0, 10.0), (0.01, 0.08), False),
        # a single trial does
        ((10.0,), (0.01,), True),
        ((10.0,), (0.08,), False),
    ],
)
def test_more_clock_parameters_need_evidence_and_half_of_the_misfit(
    gains, left_m, is_believed, monkeypatch
):
    monkeypatch.setattr(clock_offsets, "unexplained_tip_rms", lambda data, fit: data)
    simpler = clock_with(np.zeros(len(gains)), np.full(len(gains), 0.1))
    fuller = clock_with(gains, left_m)
    assert explains_more(fuller, simpler) == is_believed


def test_an_offset_explains_nothing_where_no_misfit_is_left(monkeypatch):
    monkeypatch.setattr(clock_offsets, "unexplained_tip_rms", lambda data, fit: data)
    nothing = clock_with((0.0, 0.0), (0.0, 0.0))
    assert not explains_more(clock_with((9.0, 9.0), (0.0, 0.0)), nothing)


@pytest.mark.parametrize("starts_moving", [False, True])
def test_shifted_times_are_an_offset_of_the_clocks(starts_moving):
    model = model_with_offset(MODEL, 0.02)
    observation = replace(TRIALS[0].observation, starts_moving=starts_moving)
    trial = prepare_trial(model, observation)
    fits = {}
    for offset_s in (0.0, 0.008):
        values = model.values({OFFSET: offset_s})
        chi = model.exponents_of_values(dict(zip(model.names, values, strict=True)))
        for shift_s in (0.0, 0.008):
            data = TrialData((trial.shift_times(shift_s),))
            fits[offset_s, shift_s] = data.residuals(model, chi[None])[0]
    shifted = fits[0.0, 0.008] - fits[0.0, 0.0]
    assert np.abs(shifted).max() > 10
    # a motion is interpolated between ticks of 5 ms
    assert fits[0.0, 0.008] == pytest.approx(fits[0.008, 0.0], abs=0.1)


def test_one_offset_is_compared_under_the_noise_of_separate_ones(few_starts):
    """If the separate offsets are equal, one offset has the same evidence."""
    seen = [late(TRIALS[k], 0.0, tip_alone=False).observation for k in (0, 1)]
    rng = np.random.default_rng(0)
    separate = clock_fit.fit_clock(MODEL, seen, 0.02, rng, lambda share: None)
    # a poorer fit, whose times differ by the same in all trials
    noisy = []
    for trial in separate.data.trials:
        noisy.append(replace(trial.shift_times(0.003), sigma=3 * trial.sigma))
    common = replace(separate, data=TrialData(tuple(noisy)))
    refitted = refit_with_one_offset(common, separate, 0.0)
    assert refitted.offset == pytest.approx(separate.offset - 0.003, abs=2e-4)
    # with three times the noise, it would differ by hundreds
    evidence = refitted.fit.log_evidence
    assert evidence == pytest.approx(separate.fit.log_evidence, abs=10.0)


def test_the_scatter_of_offsets_beyond_their_posterior_is_estimated():
    """With equal deviations, it is the excess variance of the means."""
    mean = np.array([0.01, -0.02, 0.03, 0.0])
    own = BackgroundPosterior(mean, 0.005**2 * np.eye(4))
    excess = np.var(mean, ddof=1) - 0.005**2
    assert scatter_of_trials(own) == pytest.approx(np.sqrt(excess))
    # a common error is no scatter, and nearer offsets have none
    shared = replace(own, covariance=own.covariance + 1.0)
    assert scatter_of_trials(shared) == pytest.approx(np.sqrt(excess), rel=1e-3)
    wide = replace(own, covariance=0.05**2 * np.eye(4))
    assert scatter_of_trials(wide) == 0.0


@pytest.mark.parametrize(
    ("stated", "severities"),
    [(240, []), (240.3, []), (241, [Severity.NOTE]), (243, [Severity.WARNING])],
)
def test_the_frame_rate_is_that_of_rounded_times_with_a_long_gap(stated, severities):
    """Times in milliseconds have a median interval of 4 ms, not 4.17."""
    t = np.round(np.arange(480) / 240, 3)
    t = t[(t < 0.9) | (t > 1.4)]
    dataset = SimpleNamespace(
        metadata_block=lambda name: {"fps": stated},
        informative_trials=lambda: [SimpleNamespace(frame_t=t, name="t00")],
        points_file="points.csv",
    )
    findings = list(check_frame_rate(dataset))
    assert [finding.severity for finding in findings] == severities
    for finding in findings:
        assert "there are 240 frames per second" in finding.statement


def fit_of_evidence(log_evidence, **data):
    """Return a stand-in for a fit of the clock."""
    fit = SimpleNamespace(log_evidence=log_evidence)
    return SimpleNamespace(data=SimpleNamespace(**data), fit=fit, offset=0.0)


def test_trials_that_scatter_widen_the_common_offset(monkeypatch):
    """The posterior is exact here; the mean of four trials has half the scatter."""
    fits = [fit_of_evidence(0.0, trials=range(4))]
    exact = BackgroundPosterior(np.zeros(1), np.zeros((1, 1)))
    monkeypatch.setattr(offset, "_average_posterior", lambda *given: exact)
    interval = offset._common_offset(fits, [[]], 0.3, 0.001, scatter_s=0.01)
    assert interval.value == pytest.approx(0.3)
    expected_s = 2 * (1.4 * 1.96 * 0.005 + 0.001)
    assert interval.high - interval.low == pytest.approx(expected_s)


def test_offsets_of_causes_are_averaged_by_their_evidence():
    """The variance of a mixture is the mean variance and the variance of means."""
    early = BackgroundPosterior(np.array([0.01]), np.array([[0.002**2]]))
    late_one = BackgroundPosterior(np.array([0.02]), np.array([[0.004**2]]))
    fits = [fit_of_evidence(np.log(3.0)), fit_of_evidence(0.0)]
    mixed = average_by_evidence(fits, [early, late_one])
    assert mixed.mean == pytest.approx([0.0125])
    variance = 0.75 * 0.002**2 + 0.25 * 0.004**2 + 0.75 * 0.25 * 0.01**2
    assert mixed.covariance == pytest.approx(np.array([[variance]]))


def with_heavy_tip(seen, ratio, rng):
    """Return a trial of a simulated string with a weight; only its tip is seen."""
    model = MODEL.with_effects(TipMass)
    observation = late(seen, 0.0).observation
    trial = prepare_trial(model, observation)
    values = np.array(model.values({"tip_mass.ratio": ratio}))
    noise = rng.normal(0.0, 5e-4, (len(trial.s), 2))
    x, y = (simulated_points(trial, values) + noise).T
    return replace(observation, points=observation.points.assign(x=x, y=y))


def test_a_large_hidden_cause_is_fitted_with_the_offset(few_starts):
    """To first order in the weight, the interval would be 17 ms wide."""
    rng = np.random.default_rng(0)
    heavy = [with_heavy_tip(seen, 0.2, rng) for seen in TRIALS[:2]]
    found = estimate_clock_offset(MODEL, heavy, rng)
    assert found.is_common
    interval = found.by_trial["t00"]
    assert interval.low < 0 < interval.high
    assert interval.high - interval.low < FRAME_S


def test_clocks_that_drift_apart_over_a_session_get_separate_offsets(few_starts):
    """The clocks gain 6 ms on each other from trial to trial; a weight is hidden."""
    rng = np.random.default_rng(0)
    lag_s = 0.006
    trials = []
    for number, seen in enumerate(TRIALS[:3]):
        heavy = with_heavy_tip(seen, 0.2, rng)
        times = heavy.points["t"] + number * lag_s
        trials.append(replace(heavy, points=heavy.points.assign(t=times)))
    found = estimate_clock_offset(MODEL, trials, rng)
    assert not found.is_common
    for number, interval in enumerate(found.by_trial.values()):
        assert interval.low < -number * lag_s < interval.high
        assert interval.high - interval.low < FRAME_S


def test_only_a_wrong_clock_is_refused(few_starts):
    rng = np.random.default_rng(0)
    trials = [late(seen, 0.0).observation for seen in TRIALS[:2]]
    assert find_wrong_clock(MODEL, trials, rng) is None
    wrong = [late(seen, 0.12).observation for seen in TRIALS[:2]]
    with pytest.raises(DataError, match=r"differ by -1[12]\d ms .*--clock fit"):
        refuse_wrong_clock(MODEL, wrong, rng)


@pytest.mark.parametrize(("explained", "is_refused"), [(0.3, False), (0.8, True)])
def test_an_offset_that_explains_little_misfit_is_not_certain(
    explained, is_refused, monkeypatch
):
    """With a wrong string model, some offset fits a little better."""
    interval = Interval(0.2, 0.1, 0.3)
    found = ClockOffset({"t00": interval}, True, None, pd.DataFrame())
    fitted = FittedOffset(found, ["fit"], [Window(-0.3, 0.3)])
    monkeypatch.setattr(offset, "fit_clock_offset", lambda *given: fitted)
    monkeypatch.setattr(offset, "explained_by_offset", lambda *given: explained)
    wrong = [late(seen, 0.12).observation for seen in TRIALS[:1]]
    answer = find_wrong_clock(MODEL, wrong, np.random.default_rng(0))
    assert (answer is found) == is_refused


def test_only_points_that_jump_away_and_back_are_left_out_of_a_fit(monkeypatch):
    """If spikes are sought again without the first ones, more points are lost."""
    seen = late(TRIALS[0], 0.12, tip_alone=False)
    points = seen.points.copy()
    jumps = np.random.default_rng(0).random(len(points)) < 0.2
    points.loc[jumps, "x"] += 0.05
    dirty = replace(seen, observation=replace(seen.observation, points=points))
    once = without_spikes(dirty)
    assert len(without_spikes(once).points) < len(once.points) < len(points)
    used = []

    def keep(trials):
        used.extend(trials)
        raise DataError("", "enough")

    monkeypatch.setattr(offset, "possible_windows", keep)
    for estimate in (find_wrong_clock, estimate_clock_offset):
        with pytest.raises(DataError, match="enough"):
            estimate(MODEL, [dirty.observation], np.random.default_rng(0))
    assert [len(trial.points) for trial in used] == 2 * [len(once.points)]


def test_a_right_clock_in_one_trial_does_not_make_others_certain(monkeypatch):
    right, wrong = Interval(0.0, -0.01, 0.01), Interval(0.2, 0.1, 0.3)
    found = ClockOffset({"t00": right, "t01": wrong}, False, None, pd.DataFrame())
    fitted = FittedOffset(found, ["right", "wrong"], [Window(-0.3, 0.3)] * 2)
    explained = {"right": 0.9, "wrong": 0.1}
    monkeypatch.setattr(offset, "explained_by_offset", lambda fit, _: explained[fit])
    assert not fitted.is_certainly_wrong()
    explained["wrong"] = 0.9
    assert fitted.is_certainly_wrong()


@pytest.mark.long
@pytest.mark.skipif(not MEASURED.exists(), reason="the measured sets are not here")
@pytest.mark.parametrize("name", ["orange_short_unweighted", "black_unweighted"])
def test_clocks_of_real_cables_with_friction_and_a_set_are_not_refused(tmp_path, name):
    for table in ("grasp", "points"):
        rows = pd.read_parquet(MEASURED / f"{table}.parquet")
        is_of_cable = rows["trial"].isin([f"drive_{name}", f"release_{name}"])
        rows[is_of_cable].to_parquet(tmp_path / f"{table}.parquet")
    longest = rows.loc[is_of_cable, "s"].max()
    checked = read_measurements(tmp_path, [f"string.length={longest}"])
    observations = [trial.observation for trial in checked.trials]
    model = plain_model(checked)
    assert find_wrong_clock(model, observations, np.random.default_rng(0)) is None


def linear_problem(responses):
    """Return data and a fit of an offset, and responses to one further effect."""
    slope = np.array([[1.0, 1.0, 1.0, 1.0]])
    residual = np.array([0.5, 0.5, 0.5, 0.5])
    error_model = SimpleNamespace(whiten=lambda rows, scale: rows)
    data = TrialData((SimpleNamespace(error_model=error_model),))
    fit = SimpleNamespace(
        hypothesis=SimpleNamespace(
            cause_names=(), model=SimpleNamespace(names=[clock_offsets.OFFSET])
        ),
        chi=np.array([0.5]),
        slopes=[slope],
        residuals=[residual],
        grid_points=[0],
    )
    clock = SimpleNamespace(data=data, fit=fit, index=0)
    scales_m = DISCREPANCY_SCALES_M[DISCREPANCY_SCALES_M < MAX_SCALE_M]
    background = Background([responses], scales_m)
    return clock_posterior(clock, background, [slope], np.array([1e-6]))


def test_an_effect_like_the_offset_widens_its_interval():
    unlike = linear_problem(np.array([[100.0, -100.0, 100.0, -100.0]]))
    assert unlike.mean == pytest.approx([-0.5], abs=1e-5)
    assert unlike.standard_deviation == pytest.approx([0.5], abs=1e-5)
    alike = linear_problem(np.array([[1e3, 1e3, 1e3, 1e3]]))
    assert alike.standard_deviation[0] > 2 * unlike.standard_deviation[0]


def write_with_clock(folder, clock):
    about = yaml.safe_load((SAMPLE / "dataset.yaml").read_text())
    folder.mkdir()
    for table in ("arm", "points"):
        data = (SAMPLE / f"{table}.parquet").read_bytes()
        (folder / f"{table}.parquet").write_bytes(data)
    (folder / "dataset.yaml").write_text(yaml.safe_dump(about | {"clock": clock}))
    return folder


def test_a_stated_interval_is_the_range_of_the_offset_in_every_model(tmp_path):
    folder = write_with_clock(tmp_path / "stated", {"low": -0.01, "high": 0.02})
    settings = settings_for_data(folder, [], "+experiment=diagnose")
    assert settings["effects"] == ["time_offset"]
    offset = settings["parameter_values"]["time_offset.offset"]
    assert offset["value"] == pytest.approx(0.005)
    assert (offset["low"], offset["high"]) == pytest.approx((-0.0175, 0.0275))
    plain = settings_for_data(SAMPLE, [], "+experiment=diagnose")
    assert plain["effects"] == []


def checked_with_late_trials(late_s, clock=None):
    """Return the sample with some seconds added to the times of its first trials."""
    trials = dict(CHECKED.data.trials)
    for seen, by in zip(TRIALS, late_s, strict=False):
        trials[seen.name] = late(seen, by, tip_alone=False).observation
    metadata = {**CHECKED.data.metadata, **({"clock": clock} if clock else {})}
    return replace(
        CHECKED, data=replace(CHECKED.data, trials=trials, metadata=metadata)
    )


@pytest.mark.parametrize(
    "late_s",
    [(0.0,) * 5, (0.013,) * 5, (0.0, 0.03)],
    ids=["none", "all alike", "one alone"],
)
def test_one_clock_or_one_odd_trial_are_not_said_to_differ(late_s):
    assert not list(check_trial_clocks(checked_with_late_trials(late_s)))


def test_trials_without_misfit_have_one_clock(monkeypatch):
    errors = np.ones((len(trial_clocks.OFFSETS_S), 3))
    errors[20, 1] = 0.0
    monkeypatch.setattr(trial_clocks, "farthest_point", lambda measured: None)
    prediction = SimpleNamespace(length=1.0, horizon=WHOLE_MOTION)
    monkeypatch.setattr(trial_clocks, "predict", lambda *_: prediction)
    monkeypatch.setattr(trial_clocks, "errors_by_offset", lambda *_: (errors, None))
    recordings = [SimpleNamespace(name=name, tracks=[]) for name in ("t00", "t01")]
    measured = SimpleNamespace(recordings=recordings)
    assert not trial_clocks.find_trial_offsets(measured)


def test_check_says_that_clocks_differ_from_trial_to_trial():
    late_s = (0.0, 0.0135, -0.0107, 0.004, -0.006)
    (found,) = check_trial_clocks(checked_with_late_trials(late_s))
    assert found.severity == Severity.WARNING
    ends = re.search(
        r"between (\S+) ms in trial t01 and (\S+) ms in trial t02", found.statement
    )
    offsets_ms = [float(end) for end in ends.groups()]
    assert offsets_ms == pytest.approx([-13.5, 10.7], abs=2.5)
    assert "--clock fit" in found.remedy
    stated = {"low": -0.02, "high": 0.02}
    assert not list(check_trial_clocks(checked_with_late_trials(late_s, stated)))


def test_a_wide_interval_is_noted_with_a_remedy(tmp_path):
    wide = read_measurements(
        write_with_clock(tmp_path / "wide", {"low": -0.02, "high": 0.02}), []
    )
    (found,) = check_clock_interval(wide)
    assert found.severity == Severity.NOTE
    assert "40 ms, or 8 frames" in found.statement
    assert "LED" in found.remedy
    narrow = read_measurements(
        write_with_clock(tmp_path / "narrow", {"low": -0.002, "high": 0.002}), []
    )
    assert not list(check_clock_interval(narrow))
    assert not list(check_clock_interval(CHECKED))


@pytest.mark.parametrize(
    "clock", [{"low": 0.1, "high": -0.1}, {"low": 0.0}, {"offset": 3.0}]
)
def test_an_invalid_clock_interval_is_refused(tmp_path, clock):
    folder = write_with_clock(tmp_path / "wrong", clock)
    with pytest.raises(DataError, match=r"dataset.yaml: clock"):
        read_metadata(folder)


def test_check_names_a_wrong_clock_unless_the_dataset_states_it(few_starts):
    shifted = {}
    for seen in TRIALS[:2]:
        shifted[seen.name] = late(seen, -0.15).observation
    data = replace(CHECKED.data, trials=shifted)
    wrong = CheckedDataset(data, CHECKED.arm, CHECKED.camera, CHECKED.length)
    overview = overview_with_clocks(wrong)
    assert not overview["usable"]
    assert "clocks of arm and camera differ" in overview["findings"][0]["statement"]
    metadata = {**data.metadata, "clock": {"low": -0.001, "high": 0.001}}
    stated = replace(wrong, data=replace(data, metadata=metadata))
    assert overview_with_clocks(stated)["usable"]


@pytest.mark.long
@pytest.mark.skipif(not CASE.exists(), reason="needs shared/cases/two_clocks")
@pytest.mark.parametrize("tip_alone", [False, True])
def test_slow_motions_of_another_simulation_give_an_interval_with_the_truth(
    called, tmp_path, tip_alone
):
    files = sorted(CASE.glob("robot_*.csv"))
    options = ["--length", "320mm"]
    for tracker in sorted(CASE.glob("tracker_*.csv")):
        table = pd.read_csv(tracker)
        if tip_alone:
            table = table[["time_s", "tip_x_mm", "tip_y_mm"]]
        files.append(tmp_path / tracker.name)
        table.to_csv(files[-1], index=False)
    if not tip_alone:
        options += ["--at", "mid=0.160", "--at", "tip=0.320"]
    options += ["--links", "0.28,0.22,0.12", "--base", "0.1,0.3", "--y-down"]
    folder = tmp_path / "mine"
    done = called("import", *files, "--to", folder, *options, "--clock", "fit")
    assert done.returncode == 0, done.stderr
    clock = read_metadata(folder)["clock"]
    still_missing = 5135.881 - clock["added"]
    assert clock["low"] < still_missing < clock["high"]
    assert clock["high"] - clock["low"] < 10 * FRAME_S
