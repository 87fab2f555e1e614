"""Strings that are let go: how each trial begins is told by its first frames alone, and
is no cause.
"""

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary
from performed import SIGMA, said_of

from stringcast.data.artifacts import JOINTS, MASKS, READINGS, Observation
from stringcast.stages.diagnose import diagnose as module
from stringcast.stages.diagnose.discretisation import with_second_order_mesh
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.state import StringState

LENGTH = 0.3
FEW = (
    "tip_mass",
    "density_taper",
    "time_offset",
    "wind",
    "rest_curvature",
    "resolution",
)


def leaning(turn):
    """At rest, and more and more turned along the string, at its end by `turn` [rad]
    from straight down.
    """
    s = np.linspace(0, LENGTH, 41)
    return StringState(0.0, s, -np.pi / 2 + turn * s / LENGTH, np.zeros(41))


def released(model, wind):
    """Three strings let go in a wind to the right [m/s], filmed from the moment of
    letting go.
    """
    blown, rng = (
        model.with_effects(*find_effects(["wind"])).with_segments(40),
        np.random.default_rng(0),
    )
    values = blown.values({**TRUTH, "wind.along_x": wind, "wind.along_y": 0.0})[None]
    t = model.arm.tick * np.arange(140)
    # the grasp points down
    angles = np.zeros((len(t), 3)) + [0.6, -0.5, -np.pi / 2 - 0.1]
    for number, turn in enumerate((0.5, -0.4, 0.3)):
        seen = blown.simulate_observation(
            resample_joint_motion(t, angles), values, t, leaning(turn)
        ).points[0][:, 10::10]
        x, y = (seen + SIGMA * rng.standard_normal(seen.shape)).reshape(-1, 2).T
        s = np.tile(blown.string.arc_lengths()[10::10], len(t))
        points = pd.DataFrame(
            {"t": np.repeat(t, seen.shape[1]), "s": s, "x": x, "y": y, "sigma": SIGMA}
        )
        log = pd.DataFrame({"t": t} | dict(zip(JOINTS, angles.T, strict=True)))
        yield Observation(
            f"t{number}",
            points,
            READINGS.empty(),
            MASKS.empty(),
            log,
            starts_moving=True,
        )


@pytest.mark.parametrize(("wind", "causes"), [(0.3, {"wind"}), (0.0, set())])
def test_another_beginning_explains_itself_and_no_wind(arm, monkeypatch, wind, causes):
    monkeypatch.setattr(
        module,
        "effects_by_name",
        lambda: {effect.name: effect for effect in find_effects(FEW)},
    )
    said = said_of(
        with_second_order_mesh(ordinary(arm)),
        list(released(with_second_order_mesh(ordinary(arm)), wind)),
        2,
    )
    assert set(said.causes["effect"]) == causes, said.sentence
    assert said.verdict == ("effect" if causes else "none")
    if causes:
        along = said.causes.set_index("parameter").loc["wind.along_x"]
        assert 0.5 * wind < along["low"] < wind < along["high"]
