"""Stored intermediate results of steps, found by their inputs."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.run.kept_files import KeptFiles
from stringcast.stages.kept_results import (
    content_digest,
    keep_results,
    use_any_store,
    use_store,
)
from tests.experiments import resolve_settings

VERSIONS = {"code": {"source": "abc"}, "packages": {"numpy": "2"}}
RESULT = (np.arange(6.0).reshape(2, 3) / 7, np.array(1e-300), np.zeros((0, 4)))


@dataclass(frozen=True)
class Mass:
    """A value with content."""

    kg: float
    points: np.ndarray


MASS = Mass(0.5, np.arange(3.0))


@pytest.fixture
def files(tmp_path):
    return KeptFiles(tmp_path / ".step.kept", VERSIONS)


def test_stored_result_is_read_bit_by_bit(files):
    assert files.find("key") is None
    files.keep("key", RESULT)
    for found, given in zip(files.find("key"), RESULT, strict=True):
        assert found.shape == given.shape
        assert found.tobytes() == given.tobytes()
    files.keep("none", ())
    assert files.find("none") == ()
    files.remove()
    assert not files.folder.exists()


def test_results_of_another_version_are_not_found(files):
    files.keep("key", RESULT)
    other = replace(files, versions={**VERSIONS, "code": {"source": "abd"}})
    assert other.find("key") is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-1],
        lambda content: content[:-1] + bytes([content[-1] ^ 1]),
        lambda content: b"",
        lambda content: b"[]\n",
        lambda content: b'{"shapes": 3, "sha256": "e3"}\n',
        lambda content: content.replace(b"[2, 3]", b"[2, 4]"),
        lambda content: content.replace(b"[2, 3]", b"[-1, 3]"),
        lambda content: b"[" * 100_000,
    ],
)
def test_damaged_result_is_ignored(files, damage):
    files.keep("key", RESULT)
    (file,) = files.folder.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert files.find("key") is None


def test_huge_result_is_not_read(files):
    files.keep("key", RESULT)
    (file,) = files.folder.iterdir()
    with file.open("r+b") as content:
        content.truncate(2**40)  # sparse file
    assert files.find("key") is None


def test_equal_calls_are_made_once(files):
    calls = []

    @keep_results
    def double(mass, *, factor=2.0):
        calls.append(mass)
        return mass.points * factor

    double(MASS)
    double(MASS)
    assert len(calls) == 2  # nothing is stored without a store
    with use_store(files):
        first = double(MASS)
        again = double(Mass(0.5, np.arange(3.0)))
        assert len(calls) == 3
        assert again.tobytes() == first.tobytes()
        double(replace(MASS, kg=0.6))
        double(MASS, factor=3.0)
    assert len(calls) == 5


def test_long_calls_are_cached_without_a_store(files):
    """A store in use stays in use."""
    calls = []

    @keep_results
    def halve(mass):
        calls.append(mass)
        return mass.points / 2

    with use_any_store():
        first = halve(MASS)
        assert halve(MASS) is first
    assert len(calls) == 1
    with use_store(files), use_any_store():
        halve(MASS)
        assert len(calls) == 2
    with use_store(files):
        halve(MASS)
    assert len(calls) == 2


def test_different_content_has_different_digests():
    others = [
        MASS,
        replace(MASS, kg=np.nextafter(0.5, 1)),
        replace(MASS, points=np.arange(3.0).astype(np.float32)),
        replace(MASS, points=np.arange(3.0)[None]),
        [MASS],
        (MASS,),
        Mass,
        "Mass",
        {"a": 1},
        {"a": True},
        None,
    ]
    assert len({content_digest(other) for other in others}) == len(others)
    with pytest.raises(TypeError, match="no content"):
        content_digest(object())


def test_digest_ignores_the_order_of_names():
    digest = content_digest({"a": 1, "b": {"c": 2, "d": 3}})
    assert digest == content_digest({"b": {"d": 3, "c": 2}, "a": 1})
    assert digest != content_digest({"a": 1, "b": {"c": 3, "d": 2}})
    assert digest != content_digest({"b": 1, "a": {"c": 2, "d": 3}})


def test_resumed_run_finds_stored_results():
    """`resume` reads its settings sorted by name."""
    settings = resolve_settings("+experiment=diagnose", "trials=data/sample")
    stored = json.loads(json.dumps(settings, sort_keys=True))
    digests = set()
    for config in (settings, stored):
        experiment = prepare_experiment(config, lambda block: block)
        digests.add(content_digest(experiment.model))
    assert len(digests) == 1
