"""Sealed benches: what they hide is as large as they say, and nowhere to be read."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from stringcast.data.dataset import read_dataset
from stringcast.data.store import content_hash
from stringcast.stages.check.check import collect_findings
from stringcast.stages.check.measured import CheckedDataset
from stringcast.stages.model.effects.camera_rotation import CameraRotation
from stringcast.stages.model.effects.equal_points import EqualPoints
from stringcast.stages.model.engine.integrators import RungeKutta4
from stringcast.stages.model.library import effects_by_name, find_effects
from stringcast.stages.model.string import PAPER_EFFECTS
from tests.benchmarks.simulators.blind import LATEST, VERSIONS, draw
from tests.benchmarks.simulators.blind.aliasing import aliased
from tests.benchmarks.simulators.blind.hidden import hidden
from tests.benchmarks.simulators.outside import causes
from tests.benchmarks.simulators.outside.vibration import Vibration

DRIFT, NULL = (VERSIONS[1].cases.index(name) for name in ("clock_drift", "none"))
# pixel_scale and arm_lag: with nothing hidden on the string there is less to compile
PAIR = 46


@pytest.fixture(scope="module")
def drawn(arm, camera):
    made = {}

    def bench(seed):
        if seed not in made:
            made[seed] = draw(seed, arm, camera, 1)
        return made[seed]

    return bench


@pytest.fixture(scope="module")
def scene(drawn):
    return drawn(NULL).scene


def true(bench):
    """What is seen without noise, in sigmas."""
    effects = [thing.effect for thing in bench.hidden]
    return bench.scene.seen(
        bench.scene.model(bench.scene.fine, effects), [bench.parameters]
    )[0]


def refitted(scene, data, effects=(), start=None):
    """What a nonlinear fit of 41 points by scipy, base and effects from where they
    truly are, leaves: (N, S, 2).
    """
    model = scene.model(scene.second_order(41), find_effects(effects))
    free = [p for p in model.parameters if p.name in {**scene.base, **(start or {})}]
    at = {**scene.base, **(start or {})}
    chi = np.array([float(p.chi(np.array(at[p.name]))) for p in free])

    def fields(chis):
        return scene.seen(
            model,
            [
                {p.name: float(p.value(c)) for p, c in zip(free, row, strict=True)}
                for row in chis
            ],
        )

    def slopes(x):
        ends = np.clip(x + 1e-4 * np.eye(len(x)), 0, 1)
        field = fields(
            np.concatenate([x[None], ends, np.clip(x - 1e-4 * np.eye(len(x)), 0, 1)])
        )
        width = np.diag(ends - np.clip(x - 1e-4 * np.eye(len(x)), 0, 1))
        return (
            ((field[1 : len(x) + 1] - field[len(x) + 1 :]) / width[:, None, None, None])
            .reshape(len(x), -1)
            .T
        )

    inside = np.clip(chi, 1e-4, 1 - 1e-4)
    found = least_squares(
        lambda x: (fields(x[None])[0] - data).ravel(),
        inside,
        slopes,
        (0, 1),
        max_nfev=8,
    )
    return data - fields(found.x[None])[0]


def test_every_cause_has_its_turn():
    count = Counter(VERSIONS[LATEST].cases)
    assert {
        e.name
        for e in effects_by_name().values()
        if e not in PAPER_EFFECTS
        and e is not EqualPoints
        and not e.excluded_from_search
    } <= set(count)
    assert {c.name for c in causes()} <= set(count)
    assert not {c.name for c in causes()} & set(effects_by_name())
    assert count["none"] == count["pair"] == 8
    assert set(count.values()) == {1, 8}


def test_another_seed_is_another_bench(drawn, tmp_path):
    """The same one is the same: `test_versions.py`, where it is drawn twice."""
    drawn(DRIFT).write(tmp_path / "one")
    drawn(NULL).write(tmp_path / "other")
    assert content_hash(tmp_path / "one") != content_hash(tmp_path / "other")


@pytest.mark.parametrize("seed", [DRIFT, PAIR])
def test_the_dataset_can_be_read_and_does_not_tell(drawn, seed, arm, camera, tmp_path):
    bench = drawn(seed)
    bench.write(tmp_path / "data")
    bench.envelope(tmp_path / "envelope.json")
    dataset = read_dataset(tmp_path / "data")
    assert not dataset.rejection_reasons
    # no false alarm
    assert (
        collect_findings(CheckedDataset(dataset, arm, camera, bench.scene.length)) == []
    )
    assert 3 <= len(dataset.trials) <= 5
    for trial in dataset.trials.values():
        times = np.unique(trial.points["t"])
        assert 0.45 < np.ptp(times) < 1.05
        assert set(np.round(np.diff(times) * 200).astype(int)) <= {1, 2, 3, 4}
        assert 15 <= trial.points["s"].nunique() <= 20
    for file in (tmp_path / "data").iterdir():
        content = file.read_bytes()
        for word in (*bench.names, *bench.parameters, "envelope", "seed", bench.kind):
            assert word.encode() not in content, f"{word} in {file.name}"
    assert all(name in (tmp_path / "envelope.json").read_text() for name in bench.names)


def test_noise_is_what_the_envelope_says(drawn):
    """In sigmas: unit variance, a third of it shared by neighbours, none by others. 1e4
    points: 1 % off at most.
    """
    bench = drawn(DRIFT)
    noise = bench.points / bench.scene.sigma - true(bench)
    assert abs(noise.std() - 1) < 0.03
    assert abs((noise[:, 1:] * noise[:, :-1]).mean() - 1 / 3) < 0.03
    assert abs((noise[:, 2:] * noise[:, :-2]).mean()) < 0.03
    assert abs((noise[1:] * noise[:-1]).mean()) < 0.03


def test_what_really_hangs_there_is_hardly_off(scene):
    """More points do not move its tip by what could be seen, nor does another method in
    time with as many points.
    """

    def tip(string):
        return scene.seen(scene.model(string), [{}])[0]

    fine, few = scene.fine, replace(scene.fine, points=40)
    assert scene.at_tip(tip(replace(fine, points=227)) - tip(fine)) < 0.2
    assert scene.at_tip(tip(replace(few, integrator=RungeKutta4())) - tip(few)) < 0.1
    assert scene.at_tip(tip(few) - tip(fine)) > 0.5  # so that it matters


def test_an_effect_is_as_large_as_the_envelope_says(drawn):
    """The base fitted anew by other means to what is really seen: within 2 sigmas and a
    fifth.
    """
    bench = drawn(DRIFT)
    (size,) = bench.sizes.values()
    left = bench.scene.at_tip(refitted(bench.scene, true(bench)))
    assert left >= 5
    assert abs(left - size) < 2 + 0.2 * size


@pytest.mark.long
def test_both_of_a_pair_are_needed_and_suffice(drawn):
    bench = drawn(PAIR)
    for thing in bench.hidden:
        own = {n: v for n, v in bench.parameters.items() if n in thing.full}
        assert (
            bench.scene.at_tip(
                refitted(bench.scene, true(bench), [thing.effect.name], own)
            )
            >= 4
        )
    assert (
        bench.scene.at_tip(
            refitted(bench.scene, true(bench), bench.names, bench.parameters)
        )
        < 2.5
    )


def test_a_null_bench_fits_to_its_noise(drawn):
    bench = drawn(NULL)
    assert not bench.hidden
    left = refitted(bench.scene, bench.points / bench.scene.sigma)
    assert abs(left.std() - 1) < 0.05
    # of 500 draws of Rayleigh's the largest is 3.5, in the mean
    assert bench.scene.at_tip(left) < 5


@pytest.mark.parametrize("cause", causes(), ids=lambda cause: cause.name)
def test_outside_causes_are_absent_at_zero_and_not_at_full(scene, cause):
    """At full size they move the tip by many sigmas, those that happen once in one
    trial only.
    """
    rng = np.random.default_rng(1)
    model = scene.model(scene.second_order(21), [cause])
    plain = scene.model(scene.second_order(21))
    values = plain.values(scene.base)[None]
    strings = [
        plain.simulate_string(cast.happened, values, cast.frames).points[0]
        for cast in scene.casts
    ]
    thing = hidden(cause, rng, [cast.frames for cast in scene.casts], strings)
    absent, large = scene.seen(model, [thing.absent, thing.at(0.5)], thing.only)
    np.testing.assert_allclose(absent, scene.seen(plain, [{}])[0], atol=1e-5)
    assert scene.at_tip(large - absent) > 6
    trial = np.repeat(
        np.arange(len(scene.casts)), [len(cast.frames) for cast in scene.casts]
    )
    moved = {int(i) for i in trial[np.abs(large - absent).max(axis=(1, 2)) > 1e-3]}
    # a place may lie in the way of one only
    assert moved == {thing.only} if cause.once else thing.only is None
    assert cause.describe(
        {p.name: thing.full[f"{cause.name}.{p.name}"] for p in cause.parameters}
    )


def test_a_library_effect_is_a_disguise_and_a_trembling_hand_is_none(scene):
    def seen(cause, sizes):
        return scene.seen(scene.model(scene.second_order(21), [cause]), [sizes])[0]

    assert aliased(scene, seen(CameraRotation, {"camera_rotation.angle": 0.02}), 5.0)
    trembling = {
        "vibration.amplitude": 2e-3,
        "vibration.frequency": 15.0,
        "vibration.towards": 0.5,
    }
    assert not aliased(scene, seen(Vibration, trembling), 5.0)
