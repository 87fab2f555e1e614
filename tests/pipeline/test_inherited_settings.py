"""Settings inherited from folders, and their precedence."""

import json

import pytest
import yaml
from omegaconf import OmegaConf

from stringcast.pipeline.run.provenance import input_hashes
from stringcast.pipeline.settings.composition import UserError, compose_settings
from stringcast.pipeline.settings.settings_from_runs import (
    add_clock_interval,
    add_weighed_tip_mass,
    inherit_settings,
    refuse_unknown_bench,
    restore_given_settings,
    settings_of_trials,
)
from tests.pipeline.test_readme_commands import ROOT


def model_settings(**values):
    return OmegaConf.create({"effects": ["wind"], "parameter_values": values})


def test_clock_offset_gets_a_wider_range_than_its_interval():
    merged = model_settings()
    add_clock_interval(merged, {"clock": {"low": -0.1, "high": 0.3}})
    assert merged.effects == ["wind", "time_offset"]
    offset = merged.parameter_values["time_offset.offset"]
    assert offset == pytest.approx({"value": 0.1, "low": -0.2, "high": 0.4})


def test_clock_offset_fitted_to_the_motion_may_hide_a_lag_of_the_arm():
    """The motion shows only their sum, so the offset may be larger by the lag."""
    merged = model_settings()
    clock = {"low": -0.1, "high": 0.3, "added": 5135.88}
    add_clock_interval(merged, {"clock": clock})
    offset = merged.parameter_values["time_offset.offset"]
    assert offset == pytest.approx({"value": 0.1, "low": -0.2, "high": 0.45})


def test_given_clock_offset_is_kept():
    merged = model_settings()
    add_clock_interval(merged, {})
    assert merged == model_settings()
    known = {"time_offset.offset": 0.05}
    merged = OmegaConf.create({"effects": ["time_offset"], "parameter_values": known})
    add_clock_interval(merged, {"clock": {"low": -0.1, "high": 0.3}})
    assert merged == {"effects": ["time_offset"], "parameter_values": known}


def test_weighed_tip_mass_has_an_interval_of_a_thousandth():
    merged = model_settings()
    add_weighed_tip_mass(merged, {"string": {"tip_mass": 0.002, "mass": 0.02}})
    assert merged.effects == ["wind", "tip_mass"]
    ratio = merged.parameter_values["tip_mass.ratio"]
    assert ratio == pytest.approx({"value": 0.1, "low": 0.0999, "high": 0.1001})


def test_given_tip_mass_is_kept():
    merged = model_settings()
    for string in ({"length": 0.3}, {"mass": 0.02}, {"mass": 0.02, "tip_mass": 0.0}):
        add_weighed_tip_mass(merged, {"string": string})
        assert merged == model_settings()
    known = {"tip_mass.ratio": 0.05}
    merged = OmegaConf.create({"effects": ["tip_mass"], "parameter_values": known})
    add_weighed_tip_mass(merged, {"string": {"tip_mass": 0.002, "mass": 0.02}})
    assert merged == {"effects": ["tip_mass"], "parameter_values": known}


def test_only_given_settings_are_restored():
    config = OmegaConf.create({"seed": 1, "arm": {"tick": 2, "speed": 3}})
    merged = OmegaConf.create({"seed": 10, "arm": {"tick": 20, "speed": 30}})
    restore_given_settings(merged, config, {"arm.tick", "unheard_of"})
    assert merged == {"seed": 10, "arm": {"tick": 2, "speed": 30}}


@pytest.mark.parametrize(
    ("given", "length", "points"),
    [((), 0.41, 12), (("string.length=0.27",), 0.27, 12), (("seed=3",), 0.41, 12)],
)
def test_command_line_overrides_an_inherited_model(tmp_path, given, length, points):
    model = {"string": {"length": 0.41}, "effects": ["wind"]}
    (tmp_path / "extended.yaml").write_text(yaml.safe_dump(model))
    words = [f"model_from={tmp_path}", f"string.points={points}", *given]
    config = OmegaConf.create(compose_settings(words))
    names = {word.partition("=")[0] for word in given}
    settings = inherit_settings(config, names)
    assert settings["string"]["length"] == length
    assert settings["string"]["points"] == points
    assert settings["effects"] == ["wind"]
    assert settings["seed"] == (3 if "seed" in names else config.seed)


SAMPLE = ROOT / "data/sample"


def inherited(*words):
    config = OmegaConf.create(compose_settings(words))
    return inherit_settings(config, {word.partition("=")[0] for word in words})


def test_measured_camera_replaces_the_configured_one(tmp_path):
    (tmp_path / "camera.yaml").write_text("fps: 120.0")
    settings = inherited(f"camera_from={tmp_path}")
    assert settings["camera"] == {"fps": 120.0}
    # references are resolved
    assert settings["hardware"]["specimen"] == settings["specimen"]


def test_weighed_masses_are_read_from_datasets_but_not_from_runs(tmp_path):
    metadata = yaml.safe_load((SAMPLE / "dataset.yaml").read_text())
    metadata["string"] |= {"mass": 0.02, "tip_mass": 0.002}
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(metadata))
    assert inherited(f"trials={tmp_path}")["effects"] == ["tip_mass"]
    (tmp_path / "config.json").write_text("{}")
    assert inherited(f"trials={tmp_path}")["effects"] == []


def test_blocks_of_a_run_are_inherited_unchanged(tmp_path):
    (tmp_path / "config.json").write_text('{"camera": {"fps": 5.0}}')
    assert inherited(f"trials={tmp_path}")["camera"] == {"fps": 5.0}


def test_settings_of_a_run_are_inherited(tmp_path):
    (tmp_path / "config.json").write_text('{"seed": 3, "name": "x"}')
    assert settings_of_trials(tmp_path, set()) == {"seed": 3}
    string = {"length": 0.3, "points": 11}
    (tmp_path / "config.json").write_text(json.dumps({"string": string}))
    brought = {"string": string, "string.length": 0.3}
    assert settings_of_trials(tmp_path, set()) == brought
    assert settings_of_trials(tmp_path, {"string"}) == {"string.length": 0.3}


def test_given_settings_are_not_inherited_from_a_dataset():
    stored = settings_of_trials(SAMPLE, set())
    assert stored["arm.links"] == [0.25, 0.2, 0.135]
    assert stored["string.length"] == pytest.approx(0.303859, abs=1e-6)
    assert stored["camera.fps"] == 200.0
    assert "camera.lens" not in stored  # the dataset has none
    others = settings_of_trials(SAMPLE, {"camera.fps", "arm", "string"})
    assert stored.keys() - others.keys() == {"camera.fps", "arm.links", "arm.base"}
    assert "string.length" not in settings_of_trials(SAMPLE, {"string.length"})


def test_arm_moves_only_for_trials_of_a_known_arm(tmp_path):
    with pytest.raises(UserError, match="does not state which arm"):
        refuse_unknown_bench(SAMPLE, {"seed"})
    refuse_unknown_bench(SAMPLE, {"hardware"})
    (tmp_path / "config.json").write_text("{}")
    refuse_unknown_bench(tmp_path, set())


def test_only_inputs_in_the_run_and_its_trials_are_read(tmp_path):
    run = tmp_path / "run"
    (run / "iterations/01/trial").mkdir(parents=True)
    (run / "iterations/01/trial/0.png").write_bytes(b"a")
    (tmp_path / "secret").write_bytes(b"b")
    names = [
        "iterations/01/trial",
        "iterations/../../secret",
        str(tmp_path / "secret"),
        str(SAMPLE / "points.parquet"),
        str(SAMPLE / "unheard_of.parquet"),
    ]
    assert [*input_hashes(run, names, None)] == names[:1]
    assert [*input_hashes(run, names, str(SAMPLE))] == [names[0], names[3]]


def test_only_frame_folders_of_a_dataset_are_read(tmp_path):
    films = tmp_path / "data" / "films"
    films.mkdir(parents=True)
    (films / "0.png").write_bytes(b"a")
    run = tmp_path / "run"
    run.mkdir()
    trials = str(tmp_path / "data")
    names = [str(films), trials]
    assert not input_hashes(run, names, trials)  # this is no dataset
    (tmp_path / "data" / "dataset.yaml").write_text("format: 1")
    assert [*input_hashes(run, names, trials)] == [str(films)]
