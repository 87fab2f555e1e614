"""Messages with a remedy that can be pasted."""

import json

import pandas as pd
import pytest

from stringcast.data import store
from stringcast.pipeline.commands import index, load_command
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.typed_settings import bind_stage
from stringcast.stages.plugins import PLUGINS_VARIABLE
from tests.faults.toy import toy_experiment, toy_run


def test_why_reports_a_run_without_steps(tmp_path):
    settings = compose_settings(["+experiment=diagnose", "trials=data/sample"])
    (tmp_path / "config.json").write_text(json.dumps(settings))
    with pytest.raises(UserError, match=r"has made no step yet. Continue it: .*resume"):
        load_command("why")([str(tmp_path)])


def test_index_reports_unnamed_plugins():
    rows = {column.name: [""] for column in index.RUNS_TABLE.columns}
    reason = "plugins (config.json): the run uses code of x, which you have not named."
    for stale, shown in ((reason, "plugin not named"), ("01: new", "yes"), ("", "")):
        numbers = {"iterations": [1], "best_E": [0.5], "seconds": [1.0]}
        runs = pd.DataFrame({**rows, **numbers, "stale": [stale]})
        (cell,) = index.printable_table(runs).columns[-1].cells
        assert str(cell) == shown


ESTIMATOR = """
def estimate(model, observations, *, candidates: int, progress=None):
    return None
"""


def test_plugin_function_with_other_inputs_is_refused(tmp_path, monkeypatch):
    """It is refused before anything runs."""
    folder = tmp_path / "odd_lab" / "estimate"
    folder.mkdir(parents=True)
    block = {"candidates": 3}
    third = ESTIMATOR.replace("observations,", "observations, previous,")
    for name, text in (("few", ESTIMATOR), ("right", third)):
        (folder / f"{name}.py").write_text(text.replace(", progress=None", ""))
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "odd_lab"))
    few, right = (f"plugins.odd_lab.estimate.{n}.estimate" for n in ("few", "right"))
    with pytest.raises(
        UserError,
        match=r"few.estimate \(file\): it takes \(model, observations\), but the stage "
        r"gives it \(model, observations, \w+\)",
    ):
        bind_stage({"_target_": few, **block}, "estimate", "file")
    bind_stage({"_target_": right, **block}, "estimate", "file")


def test_resumed_run_hashes_each_step_once(tmp_path, monkeypatch):
    """Independently of how many later steps use it."""
    experiment = toy_experiment(4, trials_used="all")
    toy_run(tmp_path / "run", experiment)
    hashed = []
    content_hash = store.content_hash

    def count(path):
        hashed.append(path)
        return content_hash(path)

    monkeypatch.setattr(run_folder.store, "content_hash", count)
    toy_run(tmp_path / "run", experiment)
    folders = [path for path in hashed if path.is_dir()]
    assert len(folders) == len(set(folders)) > 8
