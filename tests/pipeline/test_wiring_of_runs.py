"""Runs with additional stages: wiring, descriptions, and code state."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from stringcast.data.artifacts import Film, Motion, Observation, Points, Trial
from stringcast.data.schema import DataError
from stringcast.pipeline.commands import load_command, new
from stringcast.pipeline.modes import Cast, EstimateTrials
from stringcast.pipeline.modes.stored_trials import STORED_ARTIFACTS
from stringcast.pipeline.run import provenance
from stringcast.pipeline.run.experiment import refuse_lacking_settings
from stringcast.pipeline.run.iterations import History, Step
from stringcast.pipeline.run.provenance import (
    code_state,
    code_state_with,
    input_hashes,
    load_step_with_staleness,
    origin_changes,
    step_origin,
)
from stringcast.pipeline.run.stage_graph import build_graph
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import bind_stage
from stringcast.stages import spec
from stringcast.stages.plugins import PLUGINS_VARIABLE, PluginError, plugin_sources
from stringcast.stages.spec import SameIteration
from tests.faults.toy import rows, toy_experiment, toy_run
from tests.pipeline.test_stage_graph import CAST, SMOOTH, run_smooth


@pytest.fixture
def smooth(monkeypatch):
    """Register a stage that shifts all points."""
    monkeypatch.setitem(stages(), "smooth", SMOOTH)
    monkeypatch.setattr(spec, "toy_smooth", run_smooth, raising=False)


def stored_run(tmp_path):
    folder = tmp_path / "stored"
    toy_run(folder, toy_experiment(1))
    return folder


class Maker:
    """An executor that runs the stage directly."""

    def obtain(self, step):
        setup = SimpleNamespace(config={"smooth": {"by": 9.0}})
        return run_smooth(SimpleNamespace(setup=setup), step.inputs["points"])


def read_stored_trial(reading, config, film=None):
    """Read a stored trial of one point through stages, for the estimation."""
    point = rows(Points.TABLES["points"], 1, x=[1.0], valid=[True])
    tables = point, *(rows(Points.TABLES[name]) for name in ("readings", "masks"))
    trial = Observation("a", *tables, arm=rows(Trial.TABLES["arm"]))
    data = SimpleNamespace(trials={"a": trial}, films={"a": film}, folder="my trials")
    graph = build_graph([*reading, "estimate", "predict"], config, STORED_ARTIFACTS)
    history = History(Maker(), graph=graph)
    return EstimateTrials(reading, False).read_trial(history, data, "a", "estimate")


@pytest.mark.parametrize(("inputs", "x"), [({}, 10.0), ({"points": "extract"}, 1.0)])
def test_wiring_applies_to_points_of_stored_trials(smooth, inputs, x):
    config = {"estimate": {"inputs": inputs}}
    observation = read_stored_trial(("extract", "smooth"), config)
    assert observation.points["x"].iloc[0] == x


def test_stage_that_needs_frames_is_refused_without_them(smooth, monkeypatch):
    film = SameIteration(Trial | Film)
    weigh = replace(SMOOTH, name="weigh", makes=Motion, folder="weights")
    both = {"points": SameIteration(Points), "weights": SameIteration(Motion)}
    monkeypatch.setitem(stages(), "weigh", replace(weigh, inputs={"trial": film}))
    monkeypatch.setitem(stages(), "apply", replace(SMOOTH, name="apply", inputs=both))
    for reading in (("weigh", "extract", "apply"), ("extract", "weigh", "apply")):
        with pytest.raises(DataError, match=r"apply takes weights, .*mode\.again=true"):
            read_stored_trial(reading, {})


def test_stages_after_a_skipped_estimation_are_skipped(smooth, tmp_path, monkeypatch):
    judge = replace(SMOOTH, name="judge", folder="judged", is_end=True)
    inputs = {"estimate": SameIteration(stages()["estimate"].makes)}
    monkeypatch.setitem(stages(), "judge", replace(judge, inputs=inputs))
    here = toy_experiment(1, mode=Cast(stages=(*CAST, "judge")))
    film = here.stages["execute"]

    def fails(*given, **how):
        trial = film(*given, **how)
        link = trial.link.assign(valid=False, reason="the link was lost")
        return replace(trial, link=link)

    here = replace(here, stages={**here.stages, "execute": fails})
    toy_run(tmp_path / "run", here)
    made = {path.name for path in (tmp_path / "run/iterations/01").iterdir()}
    assert made == {"motion", "trial", "points"}


def test_stage_without_settings_is_refused_before_a_run(monkeypatch):
    with pytest.raises(UserError, match=r"estimate \(conf/mode\): its settings are"):
        refuse_lacking_settings(("estimate",), {}, "conf/mode")
    with pytest.raises(UserError, match=r"must hold `_target_`"):
        bind_stage({"shift": 1}, "smooth", "conf")
    with pytest.raises(UserError, match="estimate = 5: it must hold"):
        build_graph(CAST, {"estimate": 5}, {})


def test_changed_wiring_of_equal_inputs_is_stale():
    stored, current = (
        step_origin({"both": {"inputs": {"a": a, "b": b}}}, "both", 1, {"x": "1"})
        for a, b in (("extract", "smooth"), ("smooth", "extract"))
    )
    lines = [*origin_changes(stored, current, ("both.inputs",))]
    assert lines == [
        "both.inputs.a extract -> smooth",
        "both.inputs.b smooth -> extract",
    ]


def test_artifact_of_a_wrong_type_is_refused(smooth, tmp_path, monkeypatch):
    monkeypatch.setattr(spec, "toy_smooth", lambda call, points: 5)
    here = toy_experiment(1, mode=Cast(stages=(*CAST[:3], "smooth", "estimate")))
    with pytest.raises(UserError, match=r"smooth: .*returned int, not Points"):
        toy_run(tmp_path / "run", here)


# --- plugins

DESCRIPTION = """
from stringcast.data.artifacts import Points
from stringcast.stages.spec import SameIteration, StageSpec

STAGE = StageSpec(
    name={name!r}, makes={makes}, folder={folder!r}, uses=(), run="run",
    inputs={{"points": {points}}},
)
"""
RIGHT = {
    "name": "mine",
    "makes": "Points",
    "folder": "mine",
    "points": "SameIteration(Points)",
}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"folder": "../../mine"}, "'../../mine' must be a name"),
        ({"makes": "'Points'"}, "makes = 'Points' must be a dataclass with TABLES"),
        ({"points": "Points"}, "its input points must be a class in SameIteration"),
        ({"points": "SameIteration('Points')"}, "its input points must be a class"),
        ({"name": "arm"}, "the settings 'arm' are of something else"),
    ],
)
def test_wrong_stage_descriptions_are_refused(tmp_path, monkeypatch, wrong, message):
    file = tmp_path / "wrong_lab/stages/mine/__init__.py"
    file.parent.mkdir(parents=True)
    file.write_text(DESCRIPTION.format(**RIGHT | wrong))
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "wrong_lab"))
    with pytest.raises(PluginError, match=message):
        stages()


def test_linked_folders_count_as_code_of_a_plugin(tmp_path, monkeypatch):
    lab, elsewhere = tmp_path / "linked_lab", tmp_path / "elsewhere"
    (elsewhere / "mine").mkdir(parents=True)
    (elsewhere / "mine/helper.py").write_text("a = 1\n")
    lab.mkdir()
    (lab / "stages").symlink_to(elsewhere)
    (lab / "again").symlink_to(lab)  # no endless walk
    monkeypatch.setenv(PLUGINS_VARIABLE, str(lab))
    assert [*plugin_sources()] == ["plugins.linked_lab stages/mine/helper.py"]


def test_data_files_count_as_code_of_a_plugin(tmp_path, monkeypatch):
    table = tmp_path / "data_lab/stages/mine/offsets.csv"
    table.parent.mkdir(parents=True)
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "data_lab"))
    digests = set()
    for text in ("1.0", "2.0", "3.00", "4.0," * 1000, "5.0," * 1000):
        table.write_text(text)
        code_state_with.cache_clear()
        digests.add(code_state()["source"])
    assert len(digests) == 5
    # now only the size counts
    monkeypatch.setattr(provenance, "MAX_SOURCE_BYTES", 2)
    table.write_text("4.00")
    code_state_with.cache_clear()
    fourth = code_state()["source"]
    table.write_text("5.00")
    code_state_with.cache_clear()
    assert code_state()["source"] == fourth
    code_state_with.cache_clear()


def test_code_state_covers_commit_and_all_folders(monkeypatch):
    answers = {"rev-parse": "abc\n", "status": " M stages/a.py\n"}
    monkeypatch.setattr(provenance, "git_output", lambda *words: answers[words[0]])
    find_state = code_state_with.__wrapped__  # without its cache
    whole = find_state(())
    assert whole["commit"] == "abc+"
    answers["status"] = " M docs/a.md\n"
    assert find_state(())["commit"] == "abc"
    answers["rev-parse"] = ""
    assert find_state(())["commit"] == "unknown"
    monkeypatch.setattr(provenance, "CODE_FOLDERS", provenance.CODE_FOLDERS[:-1])
    assert find_state(())["source"] != whole["source"]


def test_code_state_covers_named_plugins(tmp_path, monkeypatch):
    (tmp_path / "late_lab").mkdir()
    (tmp_path / "late_lab/helper.py").write_text("a = 1\n")
    before = code_state()["source"]
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "late_lab"))
    assert code_state()["source"] != before


def test_index_and_why_ignore_other_named_plugins(tmp_path, monkeypatch, capsys):
    run = stored_run(tmp_path)
    (tmp_path / "other_lab").mkdir()
    (tmp_path / "other_lab/helper.py").write_text("a = 1\n")
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "other_lab"))
    table = tmp_path / "runs.csv"
    assert load_command("index")([str(run), "--to", str(table)]) == 0
    assert "the code" not in table.read_text()
    assert os.environ[PLUGINS_VARIABLE] == str(tmp_path / "other_lab")
    assert load_command("why")([str(run)]) == 0


def test_new_stage_must_not_have_the_name_of_an_existing_one(tmp_path):
    with pytest.raises(UserError, match="predict: there is a stage of this name"):
        new.main(["stage", "predict", "--to", str(tmp_path / "lab")])


def test_stored_frames_are_hashed_as_inputs(tmp_path):
    run = stored_run(tmp_path)
    frames = str(run / "iterations/01/trial/images")
    assert [*input_hashes(tmp_path / "new", [frames], str(run))] == [frames]
    (run / "dataset.yaml").unlink()  # foreign settings may name any folder
    assert not input_hashes(tmp_path / "new", [frames], str(run))


def test_seed_counts_for_stages_of_plugins(smooth, tmp_path, monkeypatch):
    order = (*CAST[:3], "smooth", "estimate")
    here = toy_experiment(1, mode=Cast(stages=order), smooth={"by": 1.0})
    toy_run(tmp_path, here)
    step = Step(stages()["smooth"], 1, {}, (Path("iterations/01/points"),))
    other = {**here.config, "seed": here.seed + 1}
    assert not load_step_with_staleness(other, tmp_path, step).stale_reasons
    owned = replace(SMOOTH, run="plugins.mine.stages.smooth.run")
    stored = load_step_with_staleness(other, tmp_path, replace(step, stage=owned))
    assert stored.stale_reasons == (f"seed {here.seed} -> {here.seed + 1}",)
