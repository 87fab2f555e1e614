"""Synthetic datasets: what a seed means, and whether the ground truth is true."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from stringcast.data.dataset import read_dataset
from stringcast.data.store import content_hash
from stringcast.stages.check.check import collect_findings
from stringcast.stages.check.measured import CheckedDataset
from tests.benchmarks import draw as command
from tests.benchmarks.simulators import SIMULATORS, draw, load_simulator
from tests.benchmarks.simulators.causes import LIBRARY_CAUSES, Cause, HiddenCause
from tests.benchmarks.simulators.drawing import (
    CYCLE,
    KINDS,
    Plan,
    _least_unexplained,
    kind_of,
    turn_of,
)
from tests.benchmarks.simulators.own_kernel import hideable_effects, make_string
from tests.benchmarks.simulators.rod import BASE_FIELDS
from tests.benchmarks.simulators.scene import Fidelity, remove_projection, tip_rms

NEW_EFFECT = '''
"""Everything is seen shifted to the right."""

import numpy as np

from stringcast.stages.model.effect import CameraEffect
from stringcast.stages.model.parameter import Parameter


class NewShift(CameraEffect):
    """Everything is seen shifted to the right."""

    name = "new_shift"
    parameters = (Parameter("x", "m", "shift", -0.1, 0.1, 0.0),)
    reference = "None"

    @staticmethod
    def describe(values):
        return "shifted"

    @staticmethod
    def observe(points, velocity, times, camera, x):
        return points + np.concatenate([x, 0 * x], axis=-1)
'''


@pytest.fixture(scope="module")
def drifting():
    return draw("own_kernel", 4, "effect", ["clock_drift"])


def refit_base(scene, points):
    """Return what a fit of all base parameters leaves of points (N, S, 2) [m]."""
    for _ in range(3):
        residual = points - scene.observe_all({}, Fidelity.SCREENING)
        slopes = scene.base_slopes.reshape(len(BASE_FIELDS), -1).T
        scale = np.linalg.norm(slopes, axis=0)
        step = np.linalg.lstsq(slopes / scale, residual.ravel(), rcond=1e-8)[0] / scale
        changes = {}
        for name, change in zip(BASE_FIELDS, step, strict=True):
            # slopes are for changes of 1 %
            factor = np.clip(1 + 0.01 * change, 0.3, 3.0)
            changes[name] = getattr(scene.rod, name) * factor
        scene = replace(scene, rod=scene.rod._replace(**changes), _motions={})
    residual = points - scene.observe_all({}, Fidelity.SCREENING)
    return remove_projection(residual, scene.base_slopes)


def true_points(dataset):
    """Return the points that are seen without noise, (N, S, 2) [m]."""
    [cause] = dataset.truth.causes
    return dataset.scene.observe_all(cause.settings, Fidelity.FINAL)


def test_any_ten_seeds_are_balanced():
    counts = Counter(kind_of(seed) for seed in range(7, 17))
    assert counts == Counter(CYCLE)
    assert set(counts) == {*KINDS} - {"mixed"}


@pytest.mark.parametrize("kind", ["effect", "outside"])
def test_every_single_cause_has_its_turn(kind):
    simulator = load_simulator("own_kernel")
    rng = np.random.default_rng(0)
    drawn = set()
    for seed in range(400):
        if kind_of(seed) == kind:
            plan = Plan("own_kernel", simulator, seed, kind, None)
            drawn |= {cause.name for cause in plan.draw_causes(rng, skipped=0)}
    outside = kind == "outside"
    assert drawn == {c.name for c in simulator.causes if c.outside == outside}


def test_turns_of_a_kind_count_its_seeds():
    seeds = [seed for seed in range(40) if kind_of(seed) == "effect"]
    assert [turn_of(seed, "effect") for seed in seeds] == list(range(len(seeds)))
    assert turn_of(1, "effect") == 1  # seed 1 is of another kind


def test_the_own_kernel_hides_every_effect_that_others_hide():
    names = {effect.name for effect in hideable_effects()}
    assert {cause.name for cause in LIBRARY_CAUSES} <= names


def test_an_effect_that_is_added_is_hidden_without_any_change(effects_folder):
    (effects_folder / "new_shift.py").write_text(NEW_EFFECT)
    simulator = type(load_simulator("own_kernel"))()
    assert "new_shift" in [cause.name for cause in simulator.causes]
    plan = Plan("own_kernel", simulator, 1, "effect", ("new_shift",))
    rng = np.random.default_rng(0)
    [cause] = plan.draw_causes(rng, skipped=0)
    hidden = cause.hide(rng, FakeTrials())
    assert hidden.settings(0.0) == {"new_shift.x": 0.0}
    assert abs(hidden.settings(0.5)["new_shift.x"]) == 0.05


class FakeTrials:
    """Trials of which only the number matters."""

    times = (np.zeros(1),)


def test_the_command_writes_the_dataset_of_a_seed_and_the_truth_apart(
    null_dataset, drifting, tmp_path, capsys
):
    folder, truth = tmp_path / "riddle", tmp_path / "riddle.json"
    status = command.main(["1", str(folder), str(truth), "--kind", "none"])
    assert status == 0
    assert str(truth) in capsys.readouterr().out
    assert '"kind": "none"' in truth.read_text()
    null_dataset.write(tmp_path / "same")
    drifting.write(tmp_path / "other")
    assert content_hash(tmp_path / "same") == content_hash(folder)
    assert content_hash(tmp_path / "other") != content_hash(folder)


def test_a_dataset_can_be_read_and_does_not_tell(drifting, arm, tmp_path):
    folder, truth_file = tmp_path / "data", tmp_path / "truth.json"
    drifting.write(folder)
    drifting.write_truth(truth_file)
    dataset = read_dataset(folder)
    scene = drifting.scene
    assert not dataset.rejection_reasons
    measured = CheckedDataset(dataset, arm, scene.camera, scene.rod.length)
    assert collect_findings(measured) == []  # this would be a false alarm
    assert 4 <= len(dataset.trials) <= 6
    for trial in dataset.trials.values():
        assert 12 <= trial.points["s"].nunique() <= 20
    words = ["clock_drift", "truth", "seed", "effect", "own_kernel"]
    for file in folder.iterdir():
        content = file.read_bytes()
        for word in words:
            assert word.encode() not in content, f"{word} in {file.name}"
    assert "clock_drift" in truth_file.read_text()


def test_noise_is_what_the_truth_says(drifting):
    noise = np.concatenate(drifting.points) - true_points(drifting)
    assert noise.std() == pytest.approx(drifting.truth.sigma, rel=0.1)


def test_a_cause_is_as_large_as_the_truth_says(drifting):
    """The size in the truth agrees with a separate fit of the base.

    The fit is to noiseless points.
    """
    left = tip_rms(refit_base(drifting.scene, true_points(drifting)))
    assert left == pytest.approx(drifting.truth.causes[0].size_m, rel=0.25)


def test_a_plain_dataset_fits_to_its_noise(null_dataset):
    assert not null_dataset.truth.causes
    left = refit_base(null_dataset.scene, np.concatenate(null_dataset.points))
    assert left.std() == pytest.approx(null_dataset.truth.sigma, rel=0.1)


def test_the_own_kernel_is_far_more_accurate_than_the_noise(null_dataset):
    scene = null_dataset.scene
    [cast, *_] = scene.casts
    final = scene.observe(cast, {}, Fidelity.FINAL)
    check = scene.observe(cast, {}, Fidelity.CHECK)
    error = np.linalg.norm((final - check)[:, -1], axis=-1).max()
    assert error < scene.sigma / 3
    assert error == null_dataset.truth.numerical_error_m["t00"]
    assert make_string(0.3, Fidelity.FINAL, with_all_effects=False).points > 150


@pytest.mark.long
def test_a_library_effect_is_a_disguise_and_a_shaking_base_is_none(null_dataset):
    scene, rng = null_dataset.scene, np.random.default_rng(0)
    scaled = {"camera.scale": 0.02}
    shaking = {"hand.shaking": 8e-3, "hand.shaking_frequency": 9.0}

    def hidden(settings):
        cause = Cause("fake", lambda *_: None, outside=True)
        return HiddenCause(cause, settings, settings)

    assert _least_unexplained(scene, hidden(scaled), scaled, rng) < 1e-3
    assert _least_unexplained(scene, hidden(shaking), shaking, rng) > 4e-3


@pytest.mark.long
@pytest.mark.parametrize("simulator", SIMULATORS)
def test_every_cause_of_a_triple_is_needed(simulator):
    if simulator == "pyelastica":
        pytest.importorskip("elastica")
    truth = draw(simulator, 8).truth
    assert truth.kind == "triple"
    assert len(truth.names) == 3
    assert min(cause.size_m for cause in truth.causes) >= 2.5e-3
    good = [
        e for name, e in truth.numerical_error_m.items() if name not in truth.chaotic
    ]
    assert max(good) < truth.sigma / 3


def test_a_mixture_has_known_causes_and_a_last_one_outside_the_library():
    simulator = load_simulator("nodal")
    outside = {cause.name for cause in simulator.causes if cause.outside}
    counts = Counter()
    for seed in range(200):
        plan = Plan("nodal", simulator, seed, "mixed", None)
        causes = plan.draw_causes(np.random.default_rng(seed), skipped=0)
        names = [cause.name for cause in causes]
        assert len({*names}) == len(names)
        assert [name in outside for name in names[:-1]] == [False] * (len(names) - 1)
        assert names[-1] in outside
        counts[len(names)] += 1
    assert 40 < counts[3] < 80  # two causes of the library in 30 %
    assert counts[2] + counts[3] == 200


@pytest.mark.long
def test_causes_of_a_mixture_act_together():
    """Neither part of a mixture replaces the other in what is measured."""
    dataset = draw("own_kernel", 0, "mixed")
    scene, truth = dataset.scene, dataset.truth
    everything = dict(truth.nuisances)
    for cause in truth.causes:
        assert cause.only_trial is None
        everything |= cause.settings
    full = scene.observe_all(everything, Fidelity.FINAL)
    noise = np.concatenate(dataset.points) - full
    assert noise.std() == pytest.approx(truth.sigma, rel=0.1)
    for cause in truth.causes:
        others = {
            name: v for name, v in everything.items() if name not in cause.settings
        }
        without = scene.observe_all(others, Fidelity.SEARCH)
        coarse = scene.observe_all(everything, Fidelity.SEARCH)
        assert tip_rms(coarse - without) > truth.sigma
