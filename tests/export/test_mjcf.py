"""The string in MuJoCo moves as ours does.

They agree to a fiftieth of a millimetre where the string hardly stretches, else to its
stretch.
"""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary, pipeline

from stringcast.data.schema import DataError
from stringcast.known import KnownString
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.settings.composition import UserError
from stringcast.stages.export.mjcf import CARRIAGE_MASS_RATIO, build_mjcf
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.statics.equilibrium import hanging_shape
from tests.benchmarks.speed.cord import TIMES, hand_pose

MASS, STEP = 0.01, 2.5e-4  # [kg], [s]
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


def strings(arm, more):
    plain = ordinary(arm)
    string = replace(
        plain.string, points=20, integrator=ImplicitLeapfrog(), largest_step=1e-4
    )
    effects = sorted({name.split(".")[0] for name in more})
    return replace(plain, string=string).with_effects(
        *(effects_by_name()[name] for name in effects)
    )


def tips_of_ours(model, values):
    t = np.arange(-0.1, TIMES[-1] + 0.1, 1e-3)
    return simulate(
        model.string, resample_hand_motion(t, hand_pose(t)), values[None], TIMES
    ).tip[0]


def tips_of_theirs(mujoco, model, values):
    """Simulate the chain in MuJoCo and return its tips.

    As in the benchmark, forces push the carriage so that it arrives at its poses.
    """
    theirs = mujoco.MjModel.from_xml_string(build_mjcf(model, values, MASS, STEP))
    data, steps = mujoco.MjData(theirs), round(TIMES[-1] / STEP)
    pushes = (
        CARRIAGE_MASS_RATIO
        * MASS
        * np.diff(hand_pose(np.arange(-1, steps + 2) * STEP), n=2, axis=0)
        / STEP**2
    )
    angles = hanging_shape(
        model.string, model.string.material(values[None]), hand_pose(0.0)[None]
    )[0][0]
    data.qpos[:3], data.qpos[3:] = (
        hand_pose(0.0),
        np.diff(angles, prepend=hand_pose(0.0)[2]),
    )
    tips = []
    for push in pushes:
        mujoco.mj_forward(theirs, data)
        tips.append(data.site_xpos[0, :2].copy())
        data.ctrl[:] = push
        mujoco.mj_step(theirs, data)
    return np.array(tips)[:: round((TIMES[1] - TIMES[0]) / STEP)]


@pytest.mark.parametrize("more", CASES.values(), ids=CASES)
def test_the_chain_moves_as_the_string_does(arm, more):
    mujoco = pytest.importorskip(
        "mujoco", reason="MuJoCo is installed by `python3 tasks.py bench`"
    )
    model = strings(arm, more)
    # [m]; the string of TRUTH stretches by some millimetres
    for truth, most in ((STIFF, 1e-4), (TRUTH, 4e-3)):
        values = model.values(truth | more)
        off = np.hypot(
            *(tips_of_theirs(mujoco, model, values) - tips_of_ours(model, values)).T
        )
        assert off.max() < most


def test_what_is_written_weighs_and_measures_what_the_string_does(arm):
    model = strings(arm, {"tip_mass.ratio": 0.2})
    root = ET.fromstring(
        build_mjcf(model, model.values(TRUTH | {"tip_mass.ratio": 0.2}), MASS, STEP)
    )
    links = [body for body in root.iter("body") if body.get("name").startswith("link")]
    assert len(links) == 19
    weights = [float(link.find("inertial").get("mass")) for link in links]
    # Eq. 1: the points that move weigh a segment each
    assert sum(weights) == pytest.approx(1.2 * MASS)
    assert sum(
        float(link.find("inertial").get("pos").split()[0]) for link in links
    ) == pytest.approx(0.3)


def test_what_mujoco_has_no_law_for_is_refused_by_name(arm):
    for name in ("maxwell_slip", "nonlinear_bending", "anisotropic_drag", "contact"):
        model = ordinary(arm).with_effects(effects_by_name()[name])
        with pytest.raises(DataError, match=f"effect '{name}': MuJoCo has no such law"):
            build_mjcf(model, model.values({}), MASS, STEP)


def test_the_command_writes_a_chain_and_a_card(tmp_path, capsys):
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
    assert "Left out, for no part of the string: arm_lag" in text
    assert export([str(tmp_path), str(tmp_path / "string.csv")]) == 0
    assert "tip_mass.ratio,,0.2,0.1,0.3,1," in (tmp_path / "string.csv").read_text()
    for words, says in (
        (["x.xml"], "must be given in kg"),
        (["x.step", "--mass", "1"], "names no form"),
    ):
        with pytest.raises(Exception, match=says):
            export([str(tmp_path), str(tmp_path / words[0]), *words[1:]])
    assert not (tmp_path / "x.xml").exists()


def test_a_card_of_casts_has_the_intervals_that_they_found(tmp_path):
    """A card of casts has the estimated intervals.

    A search on E gives none, and none are made up.
    """
    done = pipeline(
        "+experiment=quick",
        "estimate=least_squares",
        "saved_outputs=[]",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert done.returncode == 0, done.stderr
    assert (
        load_command("export")([str(tmp_path / "run"), str(tmp_path / "string.csv")])
        == 0
    )
    card = pd.read_csv(tmp_path / "string.csv").set_index("name")
    (found,) = (tmp_path / "run").glob("iterations/01/estimate/parameters.parquet")
    same = (
        pd.read_parquet(found)
        .set_index("name")
        .loc[card.index, ["value", "low", "high"]]
    )
    pd.testing.assert_frame_equal(
        card[["value", "low", "high"]], same, check_dtype=False
    )
    assert card["low"].notna().all()
    with pytest.raises(UserError, match="there is no such folder"):
        load_command("export")(
            [str(tmp_path / "nowhere"), str(tmp_path / "string.csv")]
        )
