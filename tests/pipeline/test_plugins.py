"""Plugins: effects, stages, functions and settings in a user's folder.

They need no change of the package. Plugins that the user has not named are never
imported.
"""

import json
import os
import re

import pandas as pd
import pytest
from conftest import ROOT

from stringcast.known import experiment_for_call
from stringcast.pipeline.commands import check, load_command, new
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.named_plugins import (
    import_plugins,
    name_plugins,
    use_stored_plugins,
)
from stringcast.pipeline.settings.typed_settings import bind_stage, build_chosen
from stringcast.stages.model.library import UnknownEffectError, find_effects
from stringcast.stages.plugins import PLUGINS_VARIABLE, PluginError, plugin_folders
from tests.benchmarks.diagnosis.study import diagnosis_document
from tests.diagnosis.slow_casts import write_slow_casts
from tests.tether import TETHER

SAMPLE = ROOT / "data" / "sample"
SMOOTH = """
from stringcast.data.artifacts import Points
from stringcast.stages.spec import SameIteration, StageSpec

STAGE = StageSpec(
    name="smooth",
    makes=Points,
    folder="smoothed",
    uses=("smooth",),
    run="plugins.my_lab.stages.smooth.smooth.run",
    inputs={"points": SameIteration(Points)},
    by=("plugins.my_lab.stages.smooth.smooth.smooth",),
)
"""
HELPERS = """
LAB = "my lab"


def moving_mean(column, window):
    return column.rolling(window, center=True, min_periods=1).mean()
"""
SMOOTH_FUNCTIONS = """
from dataclasses import replace

from stringcast.plugins.my_lab.helpers import moving_mean


def run(call, points):
    return call.by(points)


def smooth(points, *, window: int):
    table = points.points
    mean = table.groupby("s")[["x", "y"]].transform(
        lambda column: moving_mean(column, window)
    )
    return replace(points, points=table.assign(x=mean["x"], y=mean["y"]))
"""
SMOOTH_SETTINGS = """
# A moving mean over frames.
_target_: plugins.my_lab.stages.smooth.smooth.smooth
window: 1  # number of frames
"""
PAGE = '''
"""The page of the stage sway."""

from stringcast.stages.report.page import stage_page
from stringcast.stages.report.parts import Section, Text

from .helpers import LAB


def sway_page(facts):
    far = facts.artifact.farthest["sway"].max()
    parts = [Text(f"The farthest tip of {LAB} is {far:.3f} m away.")]
    return stage_page(facts, "stage", [Section("Mine", parts)], lead="By my lab.")
'''
WITH_PAGE = '    page="plugins.my_lab.pages.sway_page",\n    is_end=True,'
SWAY = ("+sway=plain", "mode=batch", "mode.stage=sway")
ESTIMATE = (
    "+experiment=estimate",
    "+smooth=plain",
    "mode.reading=[extract,smooth]",
    "estimate=uniform_search",
    "estimate.candidates=4",
    "effects=[tether]",
    "saved_outputs=[]",
)


def write_lab(folder):
    """Write a plugin with an effect, two stages, an estimator and a page."""
    for kind, name in (("stage", "sway"), ("estimator", "uniform_search")):
        assert new.main([kind, name, "--to", str(folder)]) == 0
    sway = folder / "stages" / "sway" / "__init__.py"
    sway.write_text(sway.read_text().replace("    is_end=True,", WITH_PAGE))
    texts = {
        "effects/tether.py": TETHER,
        "stages/smooth/__init__.py": SMOOTH,
        "stages/smooth/smooth.py": SMOOTH_FUNCTIONS,
        "conf/smooth/plain.yaml": SMOOTH_SETTINGS,
        "pages.py": PAGE,
        "helpers.py": HELPERS,
    }
    for path, text in texts.items():
        (folder / path).parent.mkdir(exist_ok=True, parents=True)
        (folder / path).write_text(text)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Return a plugin outside the clone."""
    folder = tmp_path_factory.mktemp("elsewhere") / "my_lab"
    write_lab(folder)
    return folder


@pytest.fixture
def trials(sample_trial):
    """Return the setting for one trial of the sample."""
    return f"trials={sample_trial}"


@pytest.fixture
def no_named_plugin(monkeypatch):
    """Name no plugin, and forget named ones after the test."""
    monkeypatch.setenv(PLUGINS_VARIABLE, "")


def run_with(called, lab, run, *words):
    """Run a command with the plugin; return its output."""
    result = called(f"plugins=[{lab}]", *words, f"hydra.run.dir={run}")
    assert result.returncode == 0, result.stderr
    return result.stdout + result.stderr


def read_table(run, name):
    """Return a table of an estimation."""
    return pd.read_parquet(run / "iterations" / "01" / "estimate" / f"{name}.parquet")


def test_plugin_effect_stage_and_estimator_take_part_in_a_run(
    lab, trials, called, no_named_plugin, tmp_path
):
    rough, smooth = tmp_path / "rough", tmp_path / "smooth"
    run_with(called, lab, rough, *ESTIMATE, trials)
    assert "tether.strength" in [*read_table(rough, "parameters")["name"]]
    fit = read_table(rough, "fit")
    assert fit["method"].iloc[0] == "uniform_search"
    assert json.loads((rough / "config.json").read_text())["plugins"] == [str(lab)]

    run_with(called, lab, smooth, *ESTIMATE, trials, "smooth.window=41")
    assert fit["before"].iloc[0] != read_table(smooth, "fit")["before"].iloc[0]

    config = json.loads((smooth / "config.json").read_text())
    config["smooth"]["window"] = 3
    (smooth / "config.json").write_text(json.dumps(config))
    output = called("why", smooth).stdout
    assert "smoothed: stale\n    smooth.window 41 -> 3" in output
    assert "estimate: stale\n" in output


def test_page_of_a_plugin_becomes_the_report(
    lab, trials, called, no_named_plugin, undrawn, tmp_path
):
    run = tmp_path / "run"
    run_with(called, lab, run, *SWAY, trials)
    assert "The farthest tip of my lab is" in (run / "report.html").read_text()
    assert called("verify", run).returncode == 0


def test_check_names_plugins_like_a_run(no_named_plugin, capsys):
    words = [str(SAMPLE), "plugins=[nothing_like_it]"]
    assert check.main(words) == check.NOT_USABLE
    assert "there is no such folder. Correct the path" in capsys.readouterr().out


def test_graph_shows_the_stage_of_a_plugin(lab, called, no_named_plugin):
    words = ("+smooth=plain", "mode.stages=[generate,execute,extract,smooth,estimate]")
    output = called("graph", f"plugins=[{lab}]", *words).stdout
    assert "estimate: takes trial of execute, points of smooth" in output


def test_jobs_of_a_sweep_use_the_plugin(
    lab, trials, called, no_named_plugin, undrawn, tmp_path
):
    folder = tmp_path / "sweep"
    swept = called(
        "--multirun",
        f"plugins=[{lab}]",
        *SWAY,
        trials,
        "sway.least=0.001",
        "saved_outputs=[]",
        f"hydra.sweep.dir={folder}",
    )
    assert swept.returncode == 0, swept.stderr
    assert len(pd.read_parquet(folder / "sweep.parquet")) == 1


def test_python_calls_name_plugins_like_the_command_line(lab, no_named_plugin):
    words = (f"plugins=[{lab}]", "effects=[tether]", "estimate=uniform_search")
    experiment = experiment_for_call(words, None)
    assert "tether" in [effect.name for effect in experiment.model.effects]
    assert experiment.config["plugins"] == [str(lab)]


def test_effect_of_an_unnamed_plugin_gives_the_setting_to_name_it():
    with pytest.raises(
        UnknownEffectError, match=r"name its folder: plugins=\[my_lab\]"
    ):
        find_effects(["tether"])


@pytest.mark.long
def test_diagnosis_finds_the_effect_of_a_plugin(
    lab, arm, camera, tmp_path, monkeypatch
):
    monkeypatch.setenv(PLUGINS_VARIABLE, str(lab))
    hidden = {"tether.strength": 15.0}
    write_slow_casts(tmp_path / "data", arm, camera, hidden)
    settings = compose_settings(["+experiment=diagnose", "string=paper"])
    document = diagnosis_document(tmp_path / "data", settings)
    assert document["verdict"] == "effect"
    (cause,) = document["causes"]
    strength = cause["parameters"]["tether.strength"]["value"]
    assert strength == pytest.approx(15.0, rel=0.1)


# --- what is refused


@pytest.fixture
def canary_lab(tmp_path):
    """Return a plugin that writes a file when imported, and that file."""
    folder, canary = tmp_path / "bad_lab", tmp_path / "canary"
    poison = f"open({str(canary)!r}, 'w')\n"
    for path in ("__init__.py", "effects/wind_2.py", "estimate/mine.py"):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(poison)
    (folder / "stages" / "mine").mkdir(parents=True)
    (folder / "stages" / "mine" / "__init__.py").write_text(poison)
    return folder, canary


@pytest.mark.parametrize("command", ["resume", "verify", "why"])
@pytest.mark.parametrize("named", ["", "my_lab"])
def test_stored_run_imports_no_unnamed_plugin(
    command, named, canary_lab, tmp_path, monkeypatch
):
    folder, canary = canary_lab
    (tmp_path / "my_lab").mkdir()
    own = str(tmp_path / named) if named else ""
    monkeypatch.setenv(PLUGINS_VARIABLE, own)
    run = tmp_path / "run"
    run.mkdir()
    config = compose_settings() | {"plugins": [str(folder)]}
    (run / "config.json").write_text(json.dumps(config))
    remedy = f"STRINGCAST_PLUGINS={os.pathsep.join(filter(None, (own, str(folder))))}$"
    with pytest.raises(
        UserError, match=rf"bad_lab, which you have not named.*{remedy}"
    ):
        load_command(command)([str(run)])
    assert not canary.exists()


def test_trials_of_a_run_do_not_load_its_plugin(
    canary_lab, called, no_named_plugin, tmp_path
):
    folder, canary = canary_lab
    trials = tmp_path / "trials"
    trials.mkdir()
    block = {"_target_": "plugins.bad_lab.estimate.mine.estimate"}
    stored = {"plugins": [str(folder)], "estimate": block}
    (trials / "config.json").write_text(json.dumps(stored))
    result = called("+experiment=estimate", f"trials={trials}")
    assert result.returncode == 1
    assert "You have not named the plugin 'bad_lab'" in result.stderr
    assert not canary.exists()
    assert not plugin_folders()


@pytest.mark.parametrize("stored", ["my_lab", {"my_lab": 1}, [1], [["my_lab"]]])
def test_malformed_stored_plugins_are_refused(stored, no_named_plugin):
    with pytest.raises(UserError, match="it must be a list of folders"):
        use_stored_plugins({"plugins": stored}, "config.json")


def test_stored_run_uses_only_its_own_plugins(tmp_path, monkeypatch):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    both = os.pathsep.join([str(tmp_path / "one"), str(tmp_path / "two")])
    monkeypatch.setenv(PLUGINS_VARIABLE, both)
    use_stored_plugins({"plugins": ["/elsewhere/two"]}, "config.json")
    assert plugin_folders() == {"two": tmp_path / "two"}


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("plugins=my_lab", r"this is a list of folders. Try: 'plugins=\[my_lab\]'"),
        ("plugins=[my_lib]", "there is no such folder. Did you mean 'my_lab'?"),
        ("plugins=[nothing_like_it]", "there is no such folder. Correct the path"),
        ("plugins=[My-Lab]", "small letters, digits and _. Rename it"),
        ("plugins=[my_lab,sub/my_lab]", "they have the same name"),
        ("plugins=[my_lab],[other]", "a sweep has one list of plugins"),
    ],
)
def test_wrong_plugin_folders_give_one_error(
    word, message, no_named_plugin, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("my_lab", "sub/my_lab", "My-Lab"):
        (tmp_path / name).mkdir(parents=True)
    with pytest.raises((UserError, PluginError), match=message):
        name_plugins([word])


BROKEN = "import no_such_package\n"
STAGE_OF_EXTRACT = SMOOTH.replace('name="smooth"', 'name="extract"')
STAGE_IN_POINTS = SMOOTH.replace('folder="smoothed"', 'folder="points"')


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("effects/pull.py", BROKEN, "effects.pull: it cannot be imported .*no_such_pa"),
        ("effects/pull.py", "def (:\n", "pull: it cannot be imported .SyntaxError"),
        ("effects/pull.py", "raise SystemExit(0)\n", "cannot be imported .SystemExit"),
        ("estimate/mine.py", BROKEN, "estimate.mine: it cannot be imported"),
        ("stages/smooth/__init__.py", BROKEN, "stages.smooth: it cannot be imported"),
        ("stages/smooth/__init__.py", "a = 1\n", "must define STAGE"),
        ("stages/smooth/__init__.py", STAGE_OF_EXTRACT, "already a stage 'extract'"),
        ("stages/smooth/__init__.py", STAGE_IN_POINTS, "the folder 'points'"),
        ("stages/smooth/__init__.py", SMOOTH, "smooth.smooth: it cannot be imported"),
        ("__init__.py", BROKEN, "my_lab.* it cannot be imported"),
        ("conf/estimate/quick.yaml", "", "has a file of this name, too"),
    ],
)
def test_unusable_plugin_is_named_and_nothing_runs(
    path, text, message, plugin, called, tmp_path
):
    (plugin / path).parent.mkdir(parents=True, exist_ok=True)
    (plugin / path).write_text(text)
    if path == "__init__.py":
        (plugin / "effects").mkdir()
        (plugin / "effects" / "tether.py").write_text(TETHER)
    run = tmp_path / "run"
    result = called("+experiment=quick", f"hydra.run.dir={run}")
    assert result.returncode == 1
    assert re.search(message, " ".join(result.stderr.split())), result.stderr
    assert "Traceback" not in result.stderr
    assert not run.exists()


def test_missing_function_of_a_stage_is_answered_with_a_similar_one(plugin):
    (plugin / "stages" / "smooth").mkdir(parents=True)
    (plugin / "stages/smooth/__init__.py").write_text(
        SMOOTH.replace("smooth.run", "smooth.rum")
    )
    (plugin / "stages/smooth/smooth.py").write_text(SMOOTH_FUNCTIONS)
    (plugin / "helpers.py").write_text(HELPERS)
    with pytest.raises(PluginError, match=r"has no rum. Did you mean 'run'\?"):
        import_plugins()


SOURCE = """
from dataclasses import dataclass

from stringcast.hardware.camera.source import Source

@dataclass(frozen=True)
class Mine(Source):
    delay: float
    name = "mine"

    def open(self, camera):
        return None

    def stills(self, camera, ready):
        return iter(())
"""


@pytest.mark.parametrize(
    ("role", "target", "message"),
    [
        ("estimate", "estimate.mine.serch", "Did you mean '.*estimate.mine.search'?"),
        ("hardware", "estimate.mine.search", "may not be named here"),
        ("integrator", "estimate.mine.search", "may not be named here"),
        ("estimate", "estimate.mine.Helper", "may not be named here"),
        ("estimate", "estimate.mine._hidden", "may not be named here"),
        ("estimate", "estimate.mine.os.system", "may not be named here"),
        ("estimate", "estimate.mine.untyped", "its argument size must state a type"),
        ("estimate", "estimate.mine.mistyped", "a type is wrong .*'Flaot'"),
    ],
)
def test_roles_accept_only_public_functions_of_their_folder(
    role, target, message, plugin
):
    (plugin / "estimate").mkdir()
    (plugin / "estimate" / "mine.py").write_text(
        "import os\n"
        "class Helper: pass\n"
        "def search(model, observations, previous, *, size: int): pass\n"
        "def _hidden(): pass\n"
        "def untyped(*given, size): pass\n"
        "def mistyped(*given, size: 'Flaot'): pass\n"
    )
    block = {"_target_": f"plugins.my_lab.{target}", "size": 1}
    with pytest.raises(UserError, match=message):
        bind_stage(block, role, "here")
    good = {"_target_": "plugins.my_lab.estimate.mine.search", "size": 1}
    assert bind_stage(good, "estimate", "here").keywords == {"size": 1}


def test_picture_sources_and_modes_must_derive_from_their_base_class(plugin):
    (plugin / "source").mkdir()
    (plugin / "mode").mkdir()
    for role in ("source", "mode"):
        (plugin / role / "mine.py").write_text(SOURCE)
    block = {"_target_": "plugins.my_lab.source.mine.Mine", "delay": 0.5}
    for role in ("source", "plane"):
        assert build_chosen(block, role, "here").delay == 0.5
    block = {"_target_": "plugins.my_lab.mode.mine.Mine", "delay": 0.5}
    with pytest.raises(UserError, match=r"derives from .*\.Mode\. Correct the class"):
        build_chosen(block, "mode", "here")
