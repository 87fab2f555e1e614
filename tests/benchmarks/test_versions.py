"""Which bench a seed means does not hang on what the library holds."""

import shutil
from pathlib import Path

import pytest

from stringcast.data.store import content_hash
from stringcast.stages.model import effects
from stringcast.stages.model.effects.equal_points import EqualPoints
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.string import PAPER_EFFECTS
from tests.benchmarks.simulators.blind import LATEST, VERSIONS, draw
from tests.benchmarks.simulators.outside import causes

ROOT = Path(__file__).resolve().parents[2]
FAKE = '''"""Nothing, for a test."""

from stringcast.stages.model.effects.anisotropic_drag import AnisotropicDrag

class Earliest(AnisotropicDrag):
    """Before all others in the alphabet, and on the string."""

    name = "aaa_earliest"
'''


@pytest.fixture
def with_one_more(monkeypatch, tmp_path):
    """A library with an effect that comes first: its folder copied, and a file added."""
    folder = tmp_path / "effects"
    shutil.copytree(effects.__path__[0], folder)
    (folder / "aaa_earliest.py").write_text(FAKE, encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [str(folder)])
    assert next(iter(effects_by_name())) == "aaa_earliest"


@pytest.mark.parametrize("case", ["clock_drift"])
def test_the_same_seed_is_the_same_bench_and_a_new_effect_moves_none(
    case, arm, camera, tmp_path, request
):
    """Case, values and noise, to the bit: of what is read, what hangs there, and what
    could pass for another.
    """
    seed = VERSIONS[1].cases.index(case)
    for when in ("before", "after"):
        bench = draw(seed, arm, camera, 1)
        bench.write(tmp_path / when)
        bench.envelope(tmp_path / when / "envelope.json")
        request.getfixturevalue("with_one_more")
    assert content_hash(tmp_path / "before") == content_hash(tmp_path / "after")


def test_every_effect_is_in_the_latest_version():
    ours = [
        e
        for e in effects_by_name().values()
        if e.__module__.startswith(effects.__name__)
    ]
    may = {
        e.name
        for e in ours
        if e not in PAPER_EFFECTS
        and not e.excluded_from_search
        and e is not EqualPoints
        and e.parameters
    }
    there = set(VERSIONS[LATEST].effects) | set(VERSIONS[LATEST].outside)
    missing = (may | {c.name for c in causes()}) - there
    assert not missing, (
        f"{missing}: add a version to tests/benchmarks/simulators/blind/version.py; leave those before as they are."
    )
