"""Plans on a coarse mesh aim as if the string had a far finer one."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stringcast.stages.generate import robust
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.generate.hit_probability import (
    CastTask,
    distances_of_segments,
    midpoint_tip_path,
    predict_outcome,
    simulate_motions,
)
from stringcast.stages.generate.mesh_correction import MeshCorrection
from stringcast.stages.generate.uncertainty_samples import UncertaintySamples
from stringcast.stages.inference.mesh import EXTRAPOLATED_MESHES
from stringcast.stages.model.model import Model
from stringcast.stages.model.target import Target
from tests.conftest import implicit_string, specimen

SAMPLES = 4
DURATION_S = 0.4


@pytest.fixture
def coarse(arm, camera):
    return Model(implicit_string(20, 1e-3), arm, camera)


@pytest.fixture
def fine(arm, camera):
    """Return a model with 16 times as many segments as the coarse one."""
    return Model(implicit_string(305, 1e-3 / 16), arm, camera)


@pytest.fixture
def values(coarse):
    return coarse.values(specimen("B").parameters)


def samples_of(values, tip_sigma=0.0):
    exact = np.zeros((SAMPLES, 3))
    normal = np.random.default_rng(0).standard_normal((SAMPLES, 2))
    known = np.repeat(values[None], SAMPLES, axis=0)
    return UncertaintySamples(known, exact, np.zeros(SAMPLES), tip_sigma, normal)


def test_corrected_tip_is_that_of_a_far_finer_mesh(arm, coarse, fine, values):
    motion = plain_cast(arm, DURATION_S)
    samples = samples_of(values)
    task = CastTask(coarse, Target(0.0, 0.0, 0.02, 0.04), ())
    true = simulate_motions(replace(task, model=fine), motion, samples).tip[0]
    plain = simulate_motions(task, motion, samples).tip[0]
    error_m = np.abs(plain - true).max()
    assert error_m > 5e-4
    for factors in (EXTRAPOLATED_MESHES[:2], EXTRAPOLATED_MESHES):
        mesh = MeshCorrection(values, factors)
        # without the random part, which is as large as meshes disagree
        samples = replace(samples, tip_normal=np.zeros((SAMPLES, 2)))
        corrected = simulate_motions(replace(task, mesh=mesh), motion, samples).tip
        assert corrected.shape[0] == SAMPLES
        assert np.abs(corrected - true).max() < 0.2 * error_m


def test_a_target_that_the_coarse_mesh_misses_is_hit(arm, coarse, fine, values):
    motion = plain_cast(arm, DURATION_S)
    samples = samples_of(values)
    anywhere = CastTask(fine, Target(0.0, 0.0, 0.02, 0.02), ())
    tip = simulate_motions(anywhere, motion, samples).tip[0]
    plain = simulate_motions(replace(anywhere, model=coarse), motion, samples).tip[0]
    path = midpoint_tip_path(plain[None])[0]
    # least distance of the coarse path from each tip on the fine mesh
    aside = distances_of_segments(path[None] - tip[:, None]).min(axis=1)
    tick = int(np.argmax(aside))
    size = aside[tick]  # of the box: its half size is half of the miss
    task = CastTask(coarse, Target(*tip[tick], size, size), ())
    assert not predict_outcome(task, motion, samples).hit.any()
    corrected = replace(task, mesh=MeshCorrection(values, EXTRAPOLATED_MESHES))
    assert predict_outcome(corrected, motion, samples).hit.all()


def test_a_motion_on_which_a_finer_mesh_diverges_does_not_hit(
    arm, coarse, values, monkeypatch
):
    motion = plain_cast(arm, DURATION_S)
    samples = samples_of(values)
    everywhere = CastTask(coarse, Target(0.0, 0.0, 9.0, 9.0), ())
    corrected = replace(everywhere, mesh=MeshCorrection(values, EXTRAPOLATED_MESHES))
    assert predict_outcome(corrected, motion, samples).hit.all()

    def diverge_on_finest(model, motion, values, times):
        found = simulate_string(model, motion, values, times)
        is_finest = model.string.points > 2 * coarse.string.points
        return replace(found, points=found.points * np.nan) if is_finest else found

    simulate_string = Model.simulate_string
    monkeypatch.setattr(Model, "simulate_string", diverge_on_finest)
    assert predict_outcome(everywhere, motion, samples).hit.all()
    outcome = predict_outcome(corrected, motion, samples)
    assert not outcome.hit.any()
    assert np.isinf(outcome.distance).all()


def test_disagreement_of_meshes_adds_to_the_error_of_the_tip(arm, coarse, values):
    motion = plain_cast(arm, DURATION_S)
    mesh = MeshCorrection(values, EXTRAPOLATED_MESHES)
    error, uncertainty = mesh.tip_errors(coarse, motion)
    tip_sigma = 2.0 * np.abs(uncertainty).max()
    task = CastTask(coarse, Target(0.0, 0.0, 0.02, 0.04), (), mesh=mesh)
    samples = samples_of(values, tip_sigma)
    errors = simulate_motions(task, motion, samples).tip_error - error
    expected = np.sqrt(tip_sigma**2 + uncertainty**2) * samples.tip_normal[:, None]
    np.testing.assert_allclose(errors, expected, atol=1e-12)


@pytest.mark.parametrize("mesh_error_m", [0.0, 1e-3])
def test_only_parameters_at_the_mesh_limit_need_a_correction(
    monkeypatch, coarse, values, mesh_error_m
):
    """Otherwise they compensate for the error of the mesh already."""
    tasks = []

    class PlannedError(Exception):
        pass

    def keep_task(task, *_):
        tasks.append(task)
        raise PlannedError

    names = coarse.names
    estimate = type(
        "Estimate",
        (),
        {
            "mesh_error_m": mesh_error_m,
            "model_error_m": 1e-3,
            "values": lambda self: dict(zip(names, values, strict=True)),
            "draws": pd.DataFrame([dict(zip(names, values, strict=True))]),
        },
    )()
    monkeypatch.setattr(robust, "sample_feasible_motions", keep_task)
    monkeypatch.setattr(robust, "find_repeated_misfit", lambda *_: None)
    search = robust.SearchEffort(16, 4, 0, 1, 0.0, 10)
    drawing = robust.MotionRanges(0.2, 0.8, 150.0, 0.25)
    uncertainty = robust.PlanningUncertainty(0.0, 0.0, 0.0)
    with pytest.raises(PlannedError):
        robust.generate(
            coarse,
            Target(0.4, 0.7, 0.02, 0.04),
            (),
            None,
            estimate,
            seed=0,
            drawing=drawing,
            search=search,
            uncertainty=uncertainty,
        )
    assert (tasks[0].mesh is not None) == (mesh_error_m > 0)
