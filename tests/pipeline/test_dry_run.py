"""A dry run makes every step except the estimation, and its trial is invalid."""

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest
import yaml

from stringcast.data.dataset import read_dataset
from stringcast.data.lazy_module import MissingPackageError
from stringcast.pipeline.commands.index import run_row
from stringcast.stages.execute.interfaces import HardwareError
from tests.faults.toy import CALLS, toy_experiment, toy_run

REASON = "dry run with the arm disabled"


def test_dry_run_makes_an_invalid_trial(called, tmp_path, undrawn):
    folder = tmp_path / "run"
    result = called("+experiment=quick", "execute=dry", f"hydra.run.dir={folder}")
    assert result.returncode == 0, result.stderr
    log = " ".join(result.stderr.replace("│", " ").split())
    assert REASON in log
    assert "nan" not in log
    sentence = json.loads((folder / "run.json").read_text())["sentence"]
    assert re.match(
        r"Dry run: .*commands went out .* ms late .* 0 of \d+ were late or lost",
        sentence,
    )
    seen, frames = map(
        int,
        re.search(r"the string was read in (\d+) of (\d+) frames", sentence).groups(),
    )
    # at rest the string hangs against other dark objects
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
    # neither a hit or miss nor a diagnosis is shown
    assert not re.search("✗|✓|experiment=diagnose", shown)
    data = read_dataset(folder)
    assert data.trials == {}
    assert data.rejection_reasons == {"t01": REASON}


class AbsentDevice:
    """A device that is not connected, or whose library is not installed."""

    def __init__(self, message, kind=HardwareError):
        self.error = kind("", message)

    def __enter__(self):
        raise self.error

    def __exit__(self, *_):
        return None


@pytest.mark.parametrize("kind", [HardwareError, MissingPackageError])
def test_all_device_faults_are_reported_before_planning(tmp_path, kind):
    experiment = toy_experiment(1)

    def with_lab(arm, camera):
        lab = {"hardware": lambda *_, **__: SimpleNamespace(arm=arm, camera=camera)}
        return replace(experiment, stages={**experiment.stages, **lab})

    CALLS.clear()
    with pytest.raises(HardwareError, match=r"no such port\.\nno such camera\."):
        toy_run(
            tmp_path / "run",
            with_lab(
                AbsentDevice("no such port", kind), AbsentDevice("no such camera")
            ),
        )
    with pytest.raises(HardwareError, match=r"^no such camera\.$"):
        toy_run(
            tmp_path / "run", with_lab(nullcontext(), AbsentDevice("no such camera"))
        )
    assert CALLS == []
    assert not (tmp_path / "run").exists()
