"""Effects in estimation and generation."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stringcast.data.artifacts import MASKS, READINGS, Observation
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.model_settings import add_effects
from stringcast.stages.estimate import least_squares
from stringcast.stages.generate.generate import MotionRanges, SearchBudget, generate
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion, resample_joint_motion
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target
from stringcast.stages.plugins import PLUGINS_VARIABLE
from tests.estimation.test_estimate import MATCHING, STRING, TRUTH
from tests.observations import grasp_table, observe_points
from tests.tether import TETHER

T = np.arange(0, 0.7, 0.005)
POSE = np.stack(
    [
        0.4 + 0.15 * np.sin(9 * T) ** 2,
        0.4 + 0.15 * np.sin(7 * T) ** 2,
        -1 + 2 * np.sin(6 * T) ** 2,
    ],
    -1,
)


def simulate_swing(model, size, noise=7e-4):
    """Simulate a swing with noise, as reported by the camera of a model."""
    t = T[::4] + 0.0013
    seen = model.simulate_observation(
        resample_hand_motion(T, POSE), model.values(TRUTH | size)[None], t
    ).points[0]
    seen = seen + noise * np.random.default_rng(0).standard_normal(seen.shape)
    grasp = grasp_table(T, POSE)
    return observe_points("t01", t, STRING.arc_lengths(), seen, noise, grasp=grasp)


def estimate_parameters(model, observation):
    """Return the estimated parameters by name, and the summary."""
    settings = {"starts": 2, "screening": 128, "iterations": 16, "matching": MATCHING}
    found = least_squares.estimate(
        model, [observation], None, seed=0, cast_number=1, **settings
    )
    return found.parameters.set_index("name"), found.fit.iloc[0]


def test_effects_on_string_clock_and_camera_are_recovered_together(arm, camera):
    """Tip mass, clock offset of 8 ms and camera rotation are recovered to 3 %."""
    size = {
        "tip_mass.ratio": 0.2,
        "time_offset.offset": 0.008,
        "camera_rotation.angle": -0.03,
    }
    plain = Model(STRING, arm, camera)
    model = plain.with_effects(*find_effects([name.split(".")[0] for name in size]))
    observation = simulate_swing(model, size)
    table, fit = estimate_parameters(model, observation)
    assert fit["rms_after"] == pytest.approx(7e-4 * np.sqrt(2), rel=0.05)
    for name, value in size.items():
        assert table.loc[name, "determined"], name
        assert table.loc[name, "value"] == pytest.approx(value, rel=0.03)
    _, without = estimate_parameters(plain, observation)
    assert without["rms_after"] > 3 * fit["rms_after"]


def test_lagging_joints_reach_their_goal_after_the_end_of_the_log(arm, camera):
    """The film is longer than the log. Otherwise the arm would stop 2 mm short."""
    t = T[T < 0.3]
    braking = np.array([0.3, 0.5, 0.2]) * (1 - (t / t[-1] - 1) ** 2)[:, None]
    log = pd.DataFrame(
        {"t": t, "q1": braking[:, 0], "q2": braking[:, 1], "q3": braking[:, 2]}
    )
    points = simulate_swing(Model(STRING, arm, camera), {}).points
    short = Observation("t01", points, READINGS.empty(), MASKS.empty(), arm=log)
    ready = prepare_trial(Model(STRING, arm, camera), short)
    acts = [(effects_by_name()["arm_lag"], {"time_constant": np.full((1, 1, 1), 0.02)})]
    goal = arm.grasp_pose(braking[-1])[:2]
    stops = (
        resample_joint_motion(t, braking).actual_hand_motion(arm, acts).pose[0, -1, :2]
    )
    arrives = ready.motion.actual_hand_motion(arm, acts)
    assert arrives.end >= ready.times[-1]
    assert np.linalg.norm(stops - goal) > 2e-3
    assert np.linalg.norm(arrives.pose[0, -1, :2] - goal) < 1e-5


def test_known_value_of_an_effect_is_refined_but_not_drawn(arm, camera):
    """Elsewhere in its range, dry friction would need a hundred times as many steps."""
    heavy = Model(STRING, arm, camera).with_effects(*find_effects(["tip_mass"]))
    known = replace(heavy, start_values={"tip_mass.ratio": 0.17})
    settings = {"starts": 2, "screening": 128, "iterations": 16, "matching": MATCHING}
    seen = simulate_swing(heavy, {"tip_mass.ratio": 0.2})
    found = least_squares.estimate(
        known, [seen], None, seed=0, cast_number=1, **settings
    )
    screened = found.candidates.iloc[: settings["screening"]]
    assert screened["tip_mass.ratio"].to_numpy() == pytest.approx(0.17)
    assert screened["bending_stiffness"].nunique() == settings["screening"]
    assert found.values()["tip_mass.ratio"] == pytest.approx(0.2, rel=0.03)


def test_effect_in_a_plugin_folder_needs_no_other_file(effects_folder, arm, camera):
    (effects_folder / "tether.py").write_text(TETHER)
    tether = effects_by_name()["tether"]
    assert tether.describe({"strength": 3.0}).startswith("a spring pulls with 3.0")
    model = Model(STRING, arm, camera).with_effects(tether)
    t = np.linspace(0, 1, 21)
    values = np.stack(
        [model.values(TRUTH | {"tether.strength": size}) for size in (0.0, 5.0)]
    )
    weak, strong = model.simulate_string(
        resample_hand_motion(T, POSE), values, t
    ).points
    assert (strong[:, -1, 1] - weak[:, -1, 1]).max() > 0.01
    table, _ = estimate_parameters(
        model, simulate_swing(model, {"tether.strength": 5.0})
    )
    assert table.loc["tether.strength", "value"] == pytest.approx(5.0, rel=0.03)


def test_files_without_a_valid_effect_are_refused(effects_folder, monkeypatch):
    (effects_folder / "compass.py").write_text(TETHER)
    with pytest.raises(
        ValueError, match=r"compass.py: it must hold one effect, with name = 'compass'"
    ):
        effects_by_name()
    (effects_folder / "compass.py").unlink()
    (effects_folder / "mute.py").write_text(
        TETHER.replace('"tether"', '"mute"').replace("def describe", "def said")
    )
    with pytest.raises(ValueError, match="the effect lacks describe"):
        effects_by_name()
    (effects_folder / "mute.py").unlink()
    (effects_folder / "wind.py").write_text(TETHER.replace('"tether"', '"wind"'))
    with pytest.raises(ValueError, match="there is an effect 'wind' already"):
        effects_by_name()
    monkeypatch.setenv(PLUGINS_VARIABLE, str(effects_folder / "nowhere"))
    with pytest.raises(ValueError, match="there is no such folder"):
        effects_by_name()


def test_model_without_effects_is_exactly_the_string(arm, camera):
    rng = np.random.default_rng(0)
    values = np.array([p.value(rng.random(20)) for p in STRING.parameters]).T
    model, t = Model(STRING, arm, camera), np.linspace(0, 1.1, 40)
    angles = rng.normal(size=3) + np.stack(
        [np.sin(9 * T) ** 2, np.sin(5 * T) ** 2, np.cos(7 * T)], axis=-1
    )
    for motion, hand in [
        (
            resample_joint_motion(T, angles),
            resample_joint_motion(T, angles).hand_motion(arm),
        ),
        (resample_hand_motion(T, POSE), resample_hand_motion(T, POSE)),
    ]:
        expected = simulate(STRING, hand, values, t)
        found = model.simulate_observation(motion, values, t)
        np.testing.assert_array_equal(found.points, expected.points)
        np.testing.assert_array_equal(found.finite, expected.finite)
    ready = prepare_trial(model, simulate_swing(model, {}))
    (_, motion), *_ = ready.simulate(values)
    np.testing.assert_array_equal(
        motion.points, simulate(STRING, hand, values, ready.times).points
    )


def test_generation_includes_the_lag_of_the_hand(arm, camera):
    """The motion hits in the model with the lag, and misses in the one without."""
    model = Model(STRING, arm, camera).with_effects(
        *find_effects(["arm_lag", "tip_mass"])
    )
    settings = {
        "drawing": MotionRanges(0.4, 0.6, 150.0, 0.25),
        "budget": SearchBudget(20000, 256, 1),
    }
    known = TRUTH | {"arm_lag.time_constant": 0.05, "tip_mass.ratio": 0.3}
    box = Target(0.4, 0.7, 0.04, 0.04)
    motion = generate(
        replace(model, start_values=known), box, (), None, None, seed=1, **settings
    )
    commands = motion.commands
    joints = resample_joint_motion(
        commands["t"].to_numpy(), commands[["q1", "q2", "q3"]].to_numpy()
    )
    t = np.arange(0, motion.duration, 0.0005)
    values = np.stack([model.values(known), model.values(TRUTH)])
    tips = model.simulate_string(joints, values, t).tip
    assert box.is_crossed_by(tips[0, :-1], tips[0, 1:]).any()
    assert not box.is_crossed_by(tips[1, :-1], tips[1, 1:]).any()


def test_wrong_effect_name_is_refused_with_a_suggestion(arm, camera):
    plain = Model(STRING, arm, camera)
    with pytest.raises(
        UserError,
        match=r"effects \(here\): there is no effect 'tipmass'\. Did you mean 'tip_mass'\?",
    ):
        add_effects(plain, ["tipmass"], "here")
    with pytest.raises(UserError, match="must be a list"):
        add_effects(plain, "tip_mass", "here")
    with pytest.raises(
        UserError,
        match=r"effects \(here\): effect 'wind' is active already\. Name it once\.",
    ):
        add_effects(plain, ["wind", "wind"], "here")
    assert add_effects(plain, ["resolution", "wind"], "here").string.points == 19
