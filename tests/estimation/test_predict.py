"""Predictions for held-out trials use only initial state and frames at rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from stringcast.data.estimates import PARAMETERS, SCORE, Estimate, Prediction
from stringcast.data.schema import DataError
from stringcast.pipeline.modes.estimate import EstimateTrials as Estimation
from stringcast.pipeline.run.result import run_summary
from stringcast.stages.estimate.prediction.predict import predict, resting_part
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.state import StringState
from tests.conftest import implicit_string
from tests.observations import grasp_table, observe_points

STRING = implicit_string(12, 1e-3)
TRUTH = {
    "axial_stiffness": 9e5,
    "axial_damping": 1300.0,
    "bending_stiffness": 60.0,
    "bending_damping": 0.3,
}
TRUTH |= {
    "linear_drag": 1.0,
    "grasp_stiffness": 5.0,
    "rest_curvature.curvature": 1.0,
    "rest_curvature.slope": 4.0,
}
T = np.arange(0, 1.0, 1 / 60)
MOVES = 0.25  # [s]
PLACES = np.array([0.15, 0.3])
NOISE = 3e-4


@pytest.fixture
def model(arm, camera):
    """Return a model with the effects of `known_answers/test_clamp.py`.

    So one step loop is compiled for both files; absent effects have no influence.
    """
    return Model(STRING, arm, camera).with_effects(
        *find_effects(["density_taper", "rest_curvature", "tip_mass"])
    )


def simulate_trial(model, values, name="driven", start=None):
    """Simulate a trial whose hand starts to move at MOVES.

    With a start state, the hand rests.
    """
    reach = 0.1 * np.sin(9 * np.maximum(T - MOVES, 0.0)) if start is None else 0 * T
    pose = np.stack([reach, 0 * T, np.full_like(T, -np.pi / 2)], axis=-1)
    true = simulate(
        model.string,
        resample_hand_motion(T, pose),
        model.values(TRUTH | values)[None],
        T,
        start,
    )
    s = model.string.arc_lengths()
    seen = np.array([interpolate_rows(PLACES, s, line) for line in true.points[0]])
    seen += np.random.default_rng(1).normal(0, NOISE, (len(T), 2, 2))
    fields = {"grasp": grasp_table(T, pose), "starts_moving": start is not None}
    return observe_points(name, T, PLACES, seen, NOISE, **fields)


def true_estimate(model, **values):
    """Return an estimate with the true values, except for the given ones."""
    rows = [
        {
            "name": p.name,
            "symbol": "",
            "unit": p.unit,
            "meaning": p.meaning,
            "value": (TRUTH | values).get(p.name, p.start),
        }
        | {
            "low": p.low,
            "high": p.high,
            "minimum": p.low,
            "maximum": p.high,
            "chi": 0.5,
            "at_bound": False,
        }
        | {"determined": True}
        for p in model.parameters
    ]
    return Estimate(PARAMETERS.check(pd.DataFrame(rows)), *[pd.DataFrame()] * 3)


def test_set_of_a_recording_is_fitted_to_frames_at_rest(model):
    """Only its two parameters are fitted; all others are as estimated."""
    other = {"rest_curvature.curvature": -2.0, "rest_curvature.slope": -8.0}
    trial, estimate = simulate_trial(model, other), true_estimate(model)
    read, plain = (
        predict(model, estimate, trial, own) for own in (["rest_curvature"], [])
    )
    assert read.score["free"].iloc[0] == 2
    assert read.score["tip"].iloc[0] < 2 * NOISE
    assert read.score["rms"].iloc[0] < 2 * NOISE
    assert plain.score["free"].iloc[0] == 0
    assert plain.score["tip"].iloc[0] > 0.02
    off = np.hypot(
        *(read.predicted[f"predicted_{c}"] - read.predicted[c] for c in "xy")
    )
    assert np.sqrt(np.mean(off[read.predicted["s"] == 0.3] ** 2)) == pytest.approx(
        read.score["tip"].iloc[0]
    )


def test_fit_at_rest_does_not_use_later_frames(model):
    trial = simulate_trial(model, {})
    late = trial.points["t"] > MOVES + 0.05
    moved = replace(trial, points=trial.points.assign(x=trial.points["x"] + 0.1 * late))
    both = [
        predict(model, true_estimate(model), each, ["rest_curvature"]).predicted[
            "predicted_x"
        ]
        for each in (trial, moved)
    ]
    np.testing.assert_array_equal(*both)


def test_resting_part_ends_when_the_hand_moves(model):
    still = resting_part(prepare_trial(model, simulate_trial(model, {})))
    assert still.times[-1] <= MOVES + 0.03  # the hand has moved by 1.5 mm
    assert len(still.times) >= np.sum(MOVES >= T)
    assert still.frame.max() == len(still.times) - 1


def test_trial_that_starts_in_motion_has_only_a_fitted_state(model):
    middle = (np.arange(60) + 0.5) * 0.3 / 60
    aside = StringState(
        0.0, middle, -np.pi / 2 + 1.2 * np.sin(np.pi / 2 * middle / 0.3), 0 * middle
    )
    trial = simulate_trial(model, {}, start=aside)
    assert resting_part(prepare_trial(model, trial)) is None
    found = predict(model, true_estimate(model), trial, ["rest_curvature"])
    assert found.score["free"].iloc[0] == 12
    assert found.score["tip"].iloc[0] < 4 * NOISE
    worse = predict(model, true_estimate(model, bending_stiffness=80.0), trial, [])
    assert worse.score["tip"].iloc[0] > 10 * NOISE


# --- prediction in a run


class Recorder:
    """An executor that records the inputs of each step and returns fixed artifacts."""

    def __init__(self):
        self.seen = []

    def obtain(self, step):
        name = step.stage.name
        trials = [o.trial for o in step.inputs["trials"].observations]
        self.seen.append((name, step.number, trials, step.inputs["estimate"]))
        score = {"trial": trials[-1], "free": 2, "rms": 0.001, "tip": 0.002}
        fit = {
            "before": 0.5,
            "after": 0.9,
            "rms_before": 0.1,
            "rms_after": 0.003,
            "tip_after": 0.004,
            "sentence": "",
        }
        artifacts = {
            "predict": Prediction(pd.DataFrame(), SCORE.check(pd.DataFrame([score])))
        }
        return artifacts.get(name) or Estimate(
            *[pd.DataFrame()] * 3, pd.DataFrame([fit])
        )


class Settings:
    """The settings that estimation from stored trials needs."""

    def __init__(self, model, trials_used, trials):
        self.model = model
        self.arm = model.arm
        self.camera = model.camera
        self.string = model.string
        self.config = {"trials_used": trials_used, "trials": str(trials)}


def run(model, folder, trials_used, held_out):
    trials = [simulate_trial(model, {}, name) for name in "abcd"]
    for table in ("grasp", "points"):
        rows = [getattr(trial, table).assign(trial=trial.trial) for trial in trials]
        pd.concat(rows).to_parquet(folder / f"{table}.parquet", index=False)
    about = {
        "format": 1,
        "string": {"length": 0.3},
        "trials": {name: {"role": "held_out"} for name in held_out},
    }
    (folder / "dataset.yaml").write_text(yaml.safe_dump(about))
    executor = Recorder()
    return executor.seen, Estimation(reading=("extract",), again=False).run_steps(
        Settings(model, trials_used, folder), Path(), executor
    )


@pytest.mark.parametrize(
    ("trials_used", "estimated"),
    [
        (1, [(1, ["a"]), (2, ["c"]), (3, ["d"])]),
        (2, [(1, ["a"]), (2, ["a", "c"]), (3, ["c", "d"])]),
        ("all", [(3, ["a", "c", "d"])]),
    ],
)
def test_held_out_trials_are_predicted_and_not_fitted(
    trials_used, estimated, model, tmp_path
):
    seen, result = run(model, tmp_path, trials_used, ["b"])
    assert [
        (number, trials) for name, number, trials, _ in seen if name == "estimate"
    ] == estimated
    name, number, trials, estimate = seen[-1]
    assert (name, number, trials) == ("predict", 4, ["b"])
    assert estimate is result.last_estimate
    rows = run_summary(result)["iterations"]
    assert [(row["tip_rms_m"], row.get("held_out")) for row in rows[-2:]] == [
        (0.004, None),
        (0.002, "b"),
    ]
    assert "Held out, the tip of b is 2.0 mm off" in result.sentence


def test_estimation_needs_a_trial_that_is_not_held_out(model, tmp_path):
    with pytest.raises(DataError, match="holds out every trial"):
        run(model, tmp_path, "all", list("abcd"))
