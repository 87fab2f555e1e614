"""The ladder of meshes.

The estimated error is the true error, and the optimum found is the minimum.
"""

import numpy as np
import pytest
from conftest import rms_distance, simulated_points

from stringcast.stages.common import rms
from stringcast.stages.inference.likelihood import Likelihood
from stringcast.stages.inference.mesh import (
    discretisation_error,
    mesh_ladder,
    normalised_discretisation_errors,
    normalised_discretisation_uncertainties,
    resolved_frames,
)
from stringcast.stages.inference.prepared_trial import prepare_trial
from stringcast.stages.inference.search import horizons
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.parameter import parameter_exponents
from tests.inference.estimation_sets import draw_cast_set, model


@pytest.fixture(scope="module")
def cast_set():
    return draw_cast_set(2)


def likelihood(cast_set, points, step):
    chain = model(points, step)
    return Likelihood(
        TrialData(tuple(prepare_trial(chain, trial) for trial in cast_set.trials)),
        chain,
    )


def test_each_mesh_has_half_the_segments_and_steps_down_to_ten_segments(cast_set):
    found = [
        (r.model.string.points - 1, r.model.string.largest_step)
        for r in mesh_ladder(likelihood(cast_set, 41, 5e-4))
    ]
    assert found == [(40, 5e-4), (20, 1e-3), (10, 2e-3)]
    for points, rungs in ((10, [10]), (19, [19]), (20, [20, 11])):
        ladder = mesh_ladder(likelihood(cast_set, points, 1e-3))
        assert [rung.model.string.points for rung in ladder] == rungs
    assert all(
        t.model is r.model
        for r in mesh_ladder(likelihood(cast_set, 41, 5e-4))
        for t in r.data.trials
    )


def test_the_error_of_a_mesh_is_of_second_order_and_the_distance_from_the_truth(
    cast_set,
):
    """The error of a mesh is of second order, and equals its distance from the truth.

    In the first 0.4 s of casts of string B it is 0.49 mm with 20 points, 0.12 mm with
    39. The truth is points without noise of a chain of 77.
    """
    chi = parameter_exponents(model().parameters, cast_set.truth)
    meshes = [
        likelihood(cast_set, *mesh).cut_after_onset(0.4)
        for mesh in ((20, 1e-3), (39, 5e-4))
    ]
    coarse, fine = (discretisation_error(mesh, chi) for mesh in meshes)
    assert coarse / fine == pytest.approx(4.0, rel=0.05)
    trial = cast_set.held_out
    far = rms_distance(prepare_trial(model(77, 2.5e-4), trial), cast_set.truth)
    own = Likelihood(TrialData((prepare_trial(model(), trial),)), model())
    assert discretisation_error(own, chi) == pytest.approx(far, rel=0.05)


def test_meshes_disagree_only_where_they_do_not_resolve_the_string(cast_set):
    """Of errors a h^2 + b h^4, extrapolation leaves a term of the fourth order."""
    chi = parameter_exponents(model().parameters, cast_set.truth)
    whole = [likelihood(cast_set, *mesh) for mesh in ((20, 1e-3), (39, 5e-4))]
    begun = [mesh.cut_after_onset(0.4) for mesh in whole]

    def uncertain_rms(mesh):
        return rms(np.concatenate(normalised_discretisation_uncertainties(mesh, chi)))

    assert uncertain_rms(begun[0]) / uncertain_rms(begun[1]) > 8
    shares = []
    for mesh in (begun[0], whole[0]):
        error = np.concatenate(normalised_discretisation_errors(mesh, chi))
        shares.append(uncertain_rms(mesh) / rms(error))
    assert shares[0] < 0.2 < shares[1]


def test_a_trial_is_resolved_until_the_error_of_the_mesh_is_large(cast_set):
    """A mesh with four times as many segments replaces the limit."""
    coarse, fine = likelihood(cast_set, 20, 1e-3), likelihood(cast_set, 77, 2.5e-4)
    chi = parameter_exponents(coarse.parameters, cast_set.truth)
    errors = normalised_discretisation_errors(coarse, chi)
    counts = resolved_frames(coarse.data.trials, errors, 1.0)
    trials = zip(coarse.data.trials, fine.data.trials, counts, strict=True)
    for trial, finer, count in trials:
        error = simulated_points(trial, cast_set.truth)
        error -= simulated_points(finer, cast_set.truth)
        in_sigmas = error / trial.sigma[:, None]
        for frame in range(count + 1):
            error_rms = np.sqrt(np.mean(in_sigmas[trial.frame == frame] ** 2))
            assert (error_rms > 1.0) == (frame == count)
        assert 2 < count < len(trial.times)


def test_the_first_horizon_ends_before_a_limp_string_swings_through(cast_set):
    """The first horizon ends before a limp string swings to the other side.

    It is a quarter of the period of a hanging chain of 0.3 m, 4 pi / 2.405 sqrt(L/g) =
    0.914 s.
    """
    first, *others, last = horizons(likelihood(cast_set, 20, 1e-3))
    assert first == pytest.approx(0.914 / 4, rel=1e-3)
    assert np.all(np.diff([first, *others]) > 0)
    assert last == np.inf
