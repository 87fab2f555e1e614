"""What others measured is read as their datasets are: of every string all trials, as long as its makers say."""

import json
from pathlib import Path

import pytest

from stringcast.data.dataset import read
from tests.measured.sets import CABLES, begins, sets, written

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "measured"


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured sets are not here")
def test_every_string_is_read_with_all_its_trials(tmp_path):
    there, told = sets(MEASURED), json.loads((MEASURED / CABLES / "cables.json").read_text())
    assert sum(len(trials) for trials in there.values()) == 28
    for name, trials in there.items():
        found = read(written(MEASURED, name, trials, tmp_path / name))
        assert sorted(found.trials) == trials
        assert not found.rejected
        length = told[name]["L_m"] if name in told else 1e-3 * int(name[:-2]) if name.endswith("mm") else 0.43
        assert found.about["string"]["length"] == pytest.approx(length, abs=1e-4)


def test_only_what_was_let_go_begins_moving():
    assert [begins(t) for t in ("drive_a", "slow_loop_650_0", "release_a", "75mm_1")] == ["rest"] * 2 + ["moving"] * 2
