"""A stage written by `new stage` runs, is stored and is reported."""

import inspect
import json
from pathlib import Path

import pandas as pd
import pytest

from stringcast.pipeline.commands import new
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import PLUGINS_VARIABLE, load_object

ROOT = Path(__file__).resolve().parents[2]
ASKED = (
    "+sway=plain",
    "mode=batch",
    "mode.stage=sway",
    f"trials={ROOT / 'data/sample'}",
)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Return a plugin with the stage, outside the clone."""
    folder = tmp_path_factory.mktemp("site") / "my_lab"
    assert new.main(["stage", "sway", "--to", str(folder)]) == 0
    return folder


def test_new_stage_runs_and_is_reported(lab, called, undrawn, tmp_path, monkeypatch):
    run = tmp_path / "run"
    monkeypatch.setenv(PLUGINS_VARIABLE, str(lab))
    done = called(*ASKED, f"hydra.run.dir={run}")
    assert done.returncode == 0, done.stderr
    (place,) = run.glob("iterations/*/sway")
    made = pd.read_parquet(place / "farthest.parquet")
    assert len(made) == 5
    assert (made["sway"] > 0.01).all()
    sentence = f"The tip moves by at most {made['sway'].max():.3f} m."
    assert sentence in done.stdout + done.stderr
    assert json.loads((run / "run.json").read_text())["sentence"] == sentence
    assert made["trial"].iloc[0] in (run / "report.html").read_text()
    assert called("verify", run).returncode == 0
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(
        json.dumps(config | {"sway": config["sway"] | {"least": 0.001}})
    )
    assert "sway.least 0.0 -> 0.001" in called("why", run).stdout


def test_declarations_of_all_stages_are_true():
    """Functions and settings exist, and functions take the declared inputs."""
    settings, folders = compose_settings(), {}
    for name, stage in stages().items():
        run = load_object(stage.run)
        assert [*inspect.signature(run).parameters] == ["call", *stage.inputs]
        assert callable(load_object(stage.page))
        assert {*stage.uses} <= settings.keys(), name
        assert bool(stage.by) == (name in settings)
        assert folders.setdefault(stage.folder, stage.makes) is stage.makes, (
            "a name is of one kind of artifact"
        )


def test_settings_of_a_new_stage_are_checked(lab, called, tmp_path, monkeypatch):
    monkeypatch.setenv(PLUGINS_VARIABLE, str(lab))
    refused = called(*ASKED, "sway.least=-1", f"hydra.run.dir={tmp_path / 'run'}")
    assert refused.returncode == 1
    place = f"sway.least = -1 ({lab}/conf/sway/plain.yaml or the command line)"
    assert place in refused.stderr
