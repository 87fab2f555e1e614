"""The string moves in MuJoCo as in our simulation.

They agree to 0.1 mm if the string hardly stretches, else to 0.2 mm.
"""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary
from scipy.stats import norm

from stringcast.data.artifacts import JOINTS, SPEEDS
from stringcast.data.schema import DataError
from stringcast.known import KnownString
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.export import samples
from stringcast.stages.export.mjcf import (
    PLAYER_TEXT,
    build_mjcf,
    choose_step,
    largest_step,
)
from stringcast.stages.export.mujoco_motion import simulate_chain
from stringcast.stages.export.trajectory import (
    joint_trajectory,
    trajectory_json,
    write_mcap,
)
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.library import effects_by_name
from tests.benchmarks.speed.cord import TIMES, hand_pose

MASS, STEP = 0.01, 5e-5  # [kg], [s]
REASON = "MuJoCo is installed by `python3 tasks.py bench`"
STIFF = TRUTH | {"axial_stiffness": 6e8, "axial_damping": 3e3}
CASES = {
    "plain": {},
    "blown about, a weight at its tip": {"wind.along_x": 1.0, "tip_mass.ratio": 0.1},
    "curved, the base not level": {
        "rest_curvature.curvature": 2.0,
        "gravity_direction.tilt": 0.05,
    },
    "heavier towards the tip": {"density_taper.taper": 0.5},
    "clamped elsewhere": {
        "clamp.hidden": 0.02,
        "clamp.along": 0.005,
        "clamp.across": -0.004,
    },
}


def build_model(arm, more):
    plain = ordinary(arm)
    string = replace(
        plain.string, points=20, integrator=ImplicitLeapfrog(), largest_step=1e-4
    )
    effects = sorted({name.split(".")[0] for name in more})
    return replace(plain, string=string).with_effects(
        *(effects_by_name()[name] for name in effects)
    )


def simulate_own_tips(model, values):
    t = np.arange(-0.1, TIMES[-1] + 0.1, 1e-3)
    return simulate(
        model.string, resample_hand_motion(t, hand_pose(t)), values[None], TIMES
    ).tip[0]


def simulate_mujoco_tips(model, values, step):
    """Simulate the tip in MuJoCo, from the keyframe at rest."""
    t = np.arange(0.0, TIMES[-1] + 0.1, 1e-3)
    hand = resample_hand_motion(t, hand_pose(t))
    document = build_mjcf(model, values, MASS, step, hand.pose[0, 0])
    return simulate_chain(document, hand, TIMES)[:, -1]


@pytest.mark.parametrize("more", CASES.values(), ids=CASES)
def test_mujoco_chain_moves_as_the_string_does(arm, more):
    pytest.importorskip("mujoco", reason=REASON)
    model = build_model(arm, more)
    # tolerances [m]; the string of TRUTH stretches by some millimetres
    for truth, most in ((STIFF, 1e-4), (TRUTH, 2e-4)):
        values = model.values(truth | more)
        step = min(choose_step(model, values), 2.5e-4)
        off = simulate_mujoco_tips(model, values, step) - simulate_own_tips(
            model, values
        )
        assert np.hypot(*off.T).max() < most


def test_links_of_a_soft_string_stretch_and_its_step_is_stable(arm):
    """Links of 1000 times the stiffness would need steps of 2 us, so they are rigid."""
    model = build_model(arm, {})
    soft, stiff = (model.values(truth) for truth in (TRUTH, STIFF))
    assert 'type="slide" axis="1 0 0" stiffness' in build_mjcf(model, soft, MASS, 1e-4)
    text = build_mjcf(model, stiff, MASS, 5e-4)
    assert "stretch_1" not in text
    assert "Links do not stretch." in text
    assert choose_step(model, soft) <= largest_step(model, soft) < 5e-4
    with pytest.raises(DataError, match=r"needs at most [\de.-]+ s in MuJoCo"):
        build_mjcf(model, soft, MASS, 5e-4)


def test_keyframe_is_at_rest(arm, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason=REASON)
    model = build_model(arm, {"rest_curvature.curvature": 2.0})
    values = model.values(TRUTH | {"rest_curvature.curvature": 2.0})
    document = build_mjcf(model, values, MASS, choose_step(model, values))
    mujoco_model = mujoco.MjModel.from_xml_string(document)
    data = mujoco.MjData(mujoco_model)
    mujoco.mj_resetDataKeyframe(mujoco_model, data, mujoco_model.key("rest").id)
    mujoco.mj_forward(mujoco_model, data)
    begin = data.site("tip").xpos.copy()
    for _ in range(2000):
        mujoco.mj_step(mujoco_model, data)
    assert np.abs(data.site("tip").xpos - begin).max() < 1e-5
    assert [mujoco_model.actuator(i).name for i in range(3)] == [
        "push_x",
        "push_y",
        "push_theta",
    ]


def test_player_is_a_short_script():
    lines = PLAYER_TEXT.format(file="string.xml").splitlines()
    compile("\n".join(lines), "play.py", "exec")
    assert sum(bool(line.strip()) for line in lines) <= 15


def test_exported_mass_and_length_are_those_of_the_string(arm):
    model = build_model(arm, {"tip_mass.ratio": 0.2})
    root = ET.fromstring(
        build_mjcf(model, model.values(TRUTH | {"tip_mass.ratio": 0.2}), MASS, STEP)
    )
    links = [body for body in root.iter("body") if body.get("name").startswith("link")]
    assert len(links) == 19
    weights = [float(link.find("inertial").get("mass")) for link in links]
    # Eq. 1: each moving point has the mass of a segment
    assert sum(weights) == pytest.approx(1.2 * MASS)
    assert sum(
        float(link.find("inertial").get("pos").split()[0]) for link in links
    ) == pytest.approx(0.3)


def test_effects_without_a_law_in_mujoco_are_refused(arm):
    for name in ("maxwell_slip", "nonlinear_bending", "anisotropic_drag", "contact"):
        model = ordinary(arm).with_effects(effects_by_name()[name])
        with pytest.raises(DataError, match=f"effect '{name}': MuJoCo has no such law"):
            build_mjcf(model, model.values({}), MASS, STEP)


def test_command_writes_mjcf_and_parameter_table(tmp_path, capsys):
    known = {
        "bending_stiffness": 4.0,
        "tip_mass.ratio": {"value": 0.2, "low": 0.1, "high": 0.3},
    }
    KnownString({"effects": ["tip_mass", "arm_lag"], "parameter_values": known}).save(
        tmp_path
    )
    export = load_command("export")
    assert export([str(tmp_path), str(tmp_path / "string.xml"), "--mass", "0.01"]) == 0
    text = (tmp_path / "string.xml").read_text()
    assert ET.fromstring(text).tag == "mujoco"
    assert "Left out, because not acting on the string: arm_lag" in text
    assert export([str(tmp_path), str(tmp_path / "string.csv")]) == 0
    assert "tip_mass.ratio,,0.2,0.1,0.3,1," in (tmp_path / "string.csv").read_text()
    for arguments, message in (
        (["x.xml"], "must be given in kg"),
        (["x.step", "--mass", "1"], "names no format"),
        (["x.json"], "it holds no motion"),
        (["x.nc"], "it holds no posterior samples"),
    ):
        with pytest.raises(Exception, match=message):
            export([str(tmp_path), str(tmp_path / arguments[0]), *arguments[1:]])
    assert not (tmp_path / "x.xml").exists()


def test_motion_is_exported_as_a_ros_trajectory(tmp_path):
    t = np.array([0.5, 0.505, 1.5])
    columns = {name: n + t for n, name in enumerate((*JOINTS, *SPEEDS))}
    commands = pd.DataFrame({"t": t} | columns)
    motion = joint_trajectory(commands, ("a", "b", "c"))
    assert motion["joint_names"] == ["a", "b", "c"]
    times = [point["time_from_start"] for point in motion["points"]]
    assert times == [
        {"sec": 0, "nanosec": 0},
        {"sec": 0, "nanosec": 5_000_000},
        {"sec": 1, "nanosec": 0},
    ]
    assert motion["points"][1]["positions"] == pytest.approx([0.505, 1.505, 2.505])
    assert motion["points"][1]["velocities"] == pytest.approx([3.505, 4.505, 5.505])
    assert json.loads(trajectory_json(motion)) == motion

    reader = pytest.importorskip(
        "mcap_ros2.reader", reason="needs: pip install mcap mcap-ros2-support"
    )
    write_mcap(motion, tmp_path / "motion.mcap")
    (message,) = reader.read_ros2_messages(tmp_path / "motion.mcap")
    assert list(message.ros_msg.joint_names) == ["a", "b", "c"]
    assert list(message.ros_msg.points[2].positions) == pytest.approx([1.5, 2.5, 3.5])


def test_log_likelihood_is_that_of_normal_errors(arm, monkeypatch):
    """Two points have errors of 1 and 2 sigma in x, with a sigma of 2 mm."""
    trial = SimpleNamespace(sigma=np.full(2, 2e-3), name="t00")
    monkeypatch.setattr(
        samples, "normalised_residuals", lambda *_: [np.array([[1.0, 0, 2.0, 0]])]
    )
    model = ordinary(arm)
    draws = pd.DataFrame([model.values(TRUTH)], columns=model.names)
    (log_likelihood,) = samples.log_likelihoods(model, [trial], draws)
    expected = norm.logpdf([2e-3, 0, 4e-3, 0], scale=2e-3).sum()
    assert log_likelihood == pytest.approx(expected)
    pytest.importorskip("arviz", reason="needs: pip install arviz h5netcdf")
    data = samples.inference_data(model, [trial], draws)
    assert dict(data.log_likelihood.sizes) == {"chain": 1, "draw": 1, "trial": 1}
    stiffness = data.posterior["bending_stiffness"]
    assert float(stiffness[0, 0]) == TRUTH["bending_stiffness"]
    assert stiffness.attrs["units"] == "N m/(rad kg)"


def test_exported_table_has_the_estimated_intervals(called, tmp_path):
    result = called(
        "+experiment=quick",
        "estimate=least_squares",
        "estimate.starts=2",
        "camera.fps=25",
        "saved_outputs=[]",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert result.returncode == 0, result.stderr
    assert (
        load_command("export")([str(tmp_path / "run"), str(tmp_path / "string.csv")])
        == 0
    )
    table = pd.read_csv(tmp_path / "string.csv").set_index("name")
    (parameters_file,) = (tmp_path / "run").glob(
        "iterations/01/estimate/parameters.parquet"
    )
    expected = (
        pd.read_parquet(parameters_file)
        .set_index("name")
        .loc[table.index, ["value", "low", "high"]]
    )
    pd.testing.assert_frame_equal(
        table[["value", "low", "high"]], expected, check_dtype=False
    )
    assert table["low"].notna().all()
    with pytest.raises(UserError, match="there is no such folder"):
        load_command("export")(
            [str(tmp_path / "nowhere"), str(tmp_path / "string.csv")]
        )
