"""Output of `new` and `template` works without changes."""

import re

import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.figure import Figure

from stringcast.data import dataset
from stringcast.data.metadata import read_metadata
from stringcast.pipeline.commands import check, new, template
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    UserError,
    compose_settings,
)
from stringcast.pipeline.settings.typed_settings import bind_stage, build_dataclass
from stringcast.stages.check.check import collect_findings
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.library import effects_by_name
from tests.laws.test_effects import law_of, samples


@pytest.mark.parametrize(
    ("kind", "made", "like"), [("arm", Arm, "paper"), ("camera", Camera, "highspeed")]
)
def test_new_arm_and_camera_are_commented_settings(kind, made, like):
    ((path, text),) = new.fill_templates(kind, "mine", "my_lab").items()
    assert path == f"conf/{kind}/mine.yaml"
    assert yaml.safe_load(text) == yaml.safe_load(
        (CONF_FOLDER / kind / f"{like}.yaml").read_text()
    )
    assert isinstance(build_dataclass(made, yaml.safe_load(text), kind, path), made)
    assert text.count("[m]") + text.count("[px]") >= 2


def test_new_effect_is_found_and_satisfies_its_invariants(plugin):
    assert new.main(["effect", "my_pull", "--to", str(plugin)]) == 0
    effect = effects_by_name()["my_pull"]
    assert effect.__name__ == "MyPull"
    for invariant in effect.invariants:
        assert invariant.error(law_of(effect, invariant.law), samples(effect, 0)) < 1e-9
    assert (
        effect.describe({"strength": 0.25})
        == "the string is pulled to the right with 0.250 m/s2"
    )
    np.testing.assert_allclose(effect.acceleration(0.5), (0.5, 0.0))
    axes = Figure().add_subplot()
    effect.plot(axes, {"strength": 0.25})
    # each curve has a line at zero
    assert [drawn.get_ydata()[0] for drawn in axes.lines[::2]] == [0.25, 0.0]
    with pytest.raises(UserError, match="it is there already"):
        new.main(["effect", "my_pull", "--to", str(plugin)])


def test_new_estimator_is_an_option_of_its_group(plugin):
    assert new.main(["estimator", "uniform_search", "--to", str(plugin)]) == 0
    block = compose_settings(["estimate=uniform_search"])["estimate"]
    assert block["_target_"] == "plugins.my_lab.estimate.uniform_search.estimate"
    bound = bind_stage(block, "estimate", "")
    assert bound.keywords["candidates"] == 500


def test_new_files_are_written_to_my_lab_in_the_current_folder(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for kind in new.KINDS:
        assert new.main([kind, f"my_{kind}"]) == 0
    written = re.findall(r"Written: (.*)", capsys.readouterr().out)
    assert len(written) == 8
    for path in written:
        assert path.startswith("my_lab/")
        assert (tmp_path / path).is_file()


@pytest.mark.parametrize(
    ("kind", "name"),
    [("effect", "wind"), ("stage", "extract"), ("stage", "arm"), ("arm", "paper")],
)
def test_names_of_the_package_are_refused(kind, name, tmp_path):
    with pytest.raises(UserError, match="it is there already"):
        new.main([kind, name, "--to", str(tmp_path / "my_lab")])
    assert not (tmp_path / "my_lab").exists()


def test_invalid_package_folder_is_refused():
    with pytest.raises(UserError, match="My-Lab: a name consists of small letters"):
        new.main(["arm", "mine", "--to", "My-Lab"])


@pytest.mark.parametrize("name", ["My Arm", "1st", "class", "../up"])
def test_invalid_name_is_refused(name):
    with pytest.raises(UserError, match="a name consists of small letters"):
        new.main(["arm", name])


@pytest.mark.parametrize(("words", "hand"), [([], "arm"), (["--poses"], "grasp")])
def test_filled_template_is_a_dataset(tmp_path, words, hand, capsys):
    folder = tmp_path / "mine"
    assert template.main([str(folder), *words]) == 0
    assert "check" in capsys.readouterr().out
    assert read_metadata(folder)["string"] == {"length": 0.3}
    assert all(
        f"{column} (" in (folder / "dataset.yaml").read_text()
        for column in ("trial", "theta" if words else "q3", "s")
    )
    assert [
        f.statement for f in collect_findings(check.read_measurements(folder, []))
    ] == ["it has no rows"] * 2
    t = np.arange(20) / 100
    for name in (hand, "points"):
        columns = pd.read_csv(folder / f"{name}.csv").columns
        pd.DataFrame({c: "t00" if c == "trial" else t for c in columns}).to_csv(
            folder / f"{name}.csv", index=False
        )
    assert len(dataset.read_dataset(folder).trials["t00"].points) == 20
