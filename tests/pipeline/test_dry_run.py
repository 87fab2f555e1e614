"""A whole run with the arm disabled.

It runs every step but estimation, and its trial is refused wherever it is read.
"""

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest
import yaml

from stringcast.data.dataset import read_dataset
from stringcast.pipeline.commands.index import run_row
from stringcast.stages.execute.interfaces import HardwareError
from tests.faults.toy import CALLS, toy_experiment, toy_run

REASON = "dry run with the arm disabled"


def test_nothing_is_learned_from_a_rehearsal(called, tmp_path):
    folder = tmp_path / "run"
    ran = called("+experiment=quick", "execute=dry", f"hydra.run.dir={folder}")
    assert ran.returncode == 0, ran.stderr
    said = " ".join(ran.stderr.replace("│", " ").split())
    assert REASON in said
    assert "nan" not in said
    sentence = json.loads((folder / "run.json").read_text())["sentence"]
    assert re.match(
        r"Dry run: .*commands went out .* ms late .* 0 of \d+ were late or lost",
        sentence,
    )
    seen, frames = map(
        int,
        re.search(r"the string was read in (\d+) of (\d+) frames", sentence).groups(),
    )
    # at the pose of rest the picture shows more than the string
    assert (seen, frames) == (0, 88)
    assert (
        "most often: something like a string hangs together with the string" in sentence
    )
    assert {path.name for path in (folder / "iterations/01").iterdir()} == {
        "motion",
        "trial",
        "points",
    }
    assert (folder / "report.html").exists()
    assert yaml.safe_load((folder / "dataset.yaml").read_text())["trials"] == {
        "t01": {"invalid": REASON}
    }
    assert run_row(folder)["outcome"] == "dry run"
    shown = (folder / "report.html").read_text(encoding="utf-8")
    assert '<span class="badge">not valid</span>' in shown
    # the string was not cast at the target, and nothing is learned
    assert not re.search("✗|✓|experiment=diagnose", shown)
    data = read_dataset(folder)
    assert data.trials == {}
    assert data.rejection_reasons == {"t01": REASON}


class Absent:
    """A device that is not connected."""

    def __init__(self, words):
        self.words = words

    def __enter__(self):
        raise HardwareError(self.words)

    def __exit__(self, *_):
        return None


def test_what_is_wrong_with_arm_and_camera_is_told_together_before_anything_is_planned(
    tmp_path,
):
    here = toy_experiment(1)

    def with_lab(arm, camera):
        lab = {"hardware": lambda *_, **__: SimpleNamespace(arm=arm, camera=camera)}
        return replace(here, stages={**here.stages, **lab})

    CALLS.clear()
    with pytest.raises(HardwareError, match=r"no such port\nno such camera"):
        toy_run(
            tmp_path / "run", with_lab(Absent("no such port"), Absent("no such camera"))
        )
    with pytest.raises(HardwareError, match=r"^no such camera$"):
        toy_run(tmp_path / "run", with_lab(nullcontext(), Absent("no such camera")))
    assert CALLS == []
    assert not (tmp_path / "run").exists()
