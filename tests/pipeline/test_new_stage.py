"""A stage is one folder and one group of settings in a folder of one's own.

As `new stage` writes it, it is found, run, kept and shown.
"""

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
    """Return a folder outside the clone with the stage."""
    folder = tmp_path_factory.mktemp("site") / "my_lab"
    assert new.main(["stage", "sway", "--to", str(folder)]) == 0
    return folder


def test_a_new_stage_is_a_folder_and_a_group_of_settings(
    lab, called, undrawn, tmp_path, monkeypatch
):
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


def test_every_stage_says_what_is_so():
    """The declarations of every stage are true.

    Their function names exist, a stage takes the inputs it declares, and the settings
    it uses exist.
    """
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


def test_its_settings_are_checked_like_any_other(lab, called, tmp_path, monkeypatch):
    monkeypatch.setenv(PLUGINS_VARIABLE, str(lab))
    refused = called(*ASKED, "sway.least=-1", f"hydra.run.dir={tmp_path / 'run'}")
    assert refused.returncode == 1
    place = f"sway.least = -1 ({lab}/conf/sway/plain.yaml or the command line)"
    assert place in refused.stderr
