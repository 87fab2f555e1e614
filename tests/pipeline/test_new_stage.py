"""A stage is one folder and one group of settings.

As `new stage` writes it, put into a copy of the package, it is found, run, kept and
shown.
"""

import inspect
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from hydra.utils import get_object

from stringcast.pipeline.commands import new
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.stage_registry import stages

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("conf", "data", "hardware", "pipeline", "stages")
ASKED = (
    "+sway=plain",
    "mode=batch",
    "mode.stage=sway",
    f"trials={ROOT / 'data/sample'}",
)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Return a copy of the package, with the stage put into it."""
    site = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "pipeline" / "api", site / "stringcast")
    shutil.copytree(ROOT / "hydra_plugins", site / "hydra_plugins")
    for room in ROOMS:
        shutil.copytree(
            ROOT / room,
            site / "stringcast" / room,
            ignore=shutil.ignore_patterns("results", "__pycache__"),
        )
    for path, text in new.stage_files("sway")[0].items():
        place = site / "stringcast" / path.relative_to(ROOT)
        place.parent.mkdir(exist_ok=True)
        place.write_text(text)
    return site


def said(package, *words):
    """Return the exit status and output of a command of the copy."""
    around = os.environ | {"PYTHONPATH": str(package)}
    call = [sys.executable, "-m", "stringcast", *map(str, words)]
    done = subprocess.run(
        call, cwd=package, env=around, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


def test_a_new_stage_is_a_folder_and_a_group_of_settings(package, tmp_path):
    run = tmp_path / "run"
    status, words = said(package, *ASKED, f"hydra.run.dir={run}")
    assert status == 0, words
    (place,) = run.glob("iterations/*/sway")
    made = pd.read_parquet(place / "farthest.parquet")
    assert len(made) == 5
    assert (made["sway"] > 0.01).all()
    sentence = f"The tip moves by at most {made['sway'].max():.3f} m."
    assert sentence in words
    assert json.loads((run / "run.json").read_text())["sentence"] == sentence
    assert made["trial"].iloc[0] in (run / "report.html").read_text()
    assert said(package, "verify", run)[0] == 0
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(
        json.dumps(config | {"sway": config["sway"] | {"least": 0.001}})
    )
    assert "sway.least 0.0 -> 0.001" in said(package, "why", run)[1]


def test_every_stage_says_what_is_so():
    """The declarations of every stage are true.

    Their function names exist, a stage takes the inputs it declares, and the settings
    it uses exist.
    """
    settings, folders = compose_settings(), {}
    for name, stage in stages().items():
        run = get_object(f"stringcast.{stage.run}")
        assert [*inspect.signature(run).parameters] == ["call", *stage.inputs]
        assert callable(get_object(f"stringcast.{stage.page}"))
        assert {*stage.uses} <= settings.keys(), name
        assert bool(stage.by) == (name in settings)
        assert folders.setdefault(stage.folder, stage.makes) is stage.makes, (
            "a name is of one kind of artifact"
        )


def test_its_settings_are_checked_like_any_other(package, tmp_path):
    status, words = said(
        package, *ASKED, "sway.least=-1", f"hydra.run.dir={tmp_path / 'run'}"
    )
    assert status == 1
    assert "sway.least = -1 (conf/sway/plain.yaml or the command line)" in words
