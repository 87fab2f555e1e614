"""Foreign settings choose among known options and execute nothing."""

import json
import os
import pickle

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from stringcast.data.schema import DataError
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.run import log, run_folder
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings import allowed_callables
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    UserError,
    compose_settings,
    refuse_repeated_settings,
)
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    read_extended_model,
    read_measured_camera,
    refuse_inherited_limits,
)
from stringcast.pipeline.settings.typed_settings import load_callable
from stringcast.stages.model.engine import module_cache
from tests.experiments import resolve_settings


class Touch:
    """An object whose unpickling makes a file."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.fixture
def canary(tmp_path):
    return tmp_path / "canary"


def poisons(canary):
    """Return malicious settings by place; each would make the file `canary`."""
    pickled = canary.with_suffix(".npy")
    pickled.write_bytes(pickle.dumps(Touch(canary)))
    return {
        "string.integrator": {
            "_target_": "stages.model.engine.module_cache.import_generated_module",
            "text": f"import os; os.mkdir({str(canary)!r})",
        },
        "estimate": {"_target_": "builtins.open", "file": str(canary), "mode": "w"},
        "hardware": {
            "_target_": "pathlib.Path.write_text",
            "self": str(canary),
            "data": "",
        },
        "generate": {
            "_target_": "numpy.load",
            "file": str(pickled),
            "allow_pickle": True,
        },
    }


PLACES = ("string.integrator", "estimate", "hardware", "generate")


@pytest.fixture(scope="module")
def settings():
    return resolve_settings("+experiment=quick")


def poisoned(settings, place, poison):
    whole = OmegaConf.create(settings)
    OmegaConf.update(whole, place, poison, merge=False)
    return OmegaConf.to_container(whole)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("asked", ["why", "verify", "resume", "index"])
def test_stored_run_executes_no_code(settings, canary, tmp_path, place, asked):
    run = tmp_path / "outputs" / "run"
    run.mkdir(parents=True)
    (run / "config.json").write_text(
        json.dumps(poisoned(settings, place, poisons(canary)[place]))
    )
    if asked in ("index", "why"):  # these commands read files and settings alone
        assert load_command(asked)([str(run.parent if asked == "index" else run)]) == (
            asked == "why"
        )
    else:
        with pytest.raises(
            UserError,
            match=rf"{place}._target_ = .*config\.json.*may not be named here\. Choose",
        ):
            load_command(asked)([str(run)])
    assert not canary.exists()
    assert [path.name for path in run.iterdir()] == ["config.json"]


def test_index_and_why_build_no_model(settings, tmp_path, monkeypatch, capsys):
    (tmp_path / "config.json").write_text(json.dumps(settings))
    monkeypatch.setattr("stringcast.stages.model.string.String.__init__", None)
    assert load_command("index")([str(tmp_path)]) == 0
    assert load_command("why")([str(tmp_path)]) == 1
    assert "iterations/01/motion: missing" in capsys.readouterr().out


def test_extended_model_executes_no_code(settings, canary, tmp_path):
    made = {"string": {"integrator": poisons(canary)["string.integrator"]}}
    (tmp_path / "extended.yaml").write_text(yaml.safe_dump(made))
    config = OmegaConf.create({**settings, "model_from": str(tmp_path)})
    with pytest.raises(UserError, match=r"string\.integrator"):
        prepare_experiment(
            inherit_settings(config, set()), lambda block: "extended.yaml"
        )
    assert not canary.exists()


def test_stored_trials_execute_no_code(settings, canary, tmp_path):
    poison = poisons(canary)["estimate"]
    (tmp_path / "config.json").write_text(
        json.dumps(poisoned(settings, "estimate", poison))
    )
    config = OmegaConf.create({**settings, "trials": str(tmp_path)})
    with pytest.raises(UserError, match=r"estimate\._target_"):
        prepare_experiment(inherit_settings(config, set()), lambda block: "config.json")
    assert not canary.exists()


@pytest.mark.parametrize("name", ["mode", "hardware", "arm", "trials", "_target_"])
def test_extended_model_sets_only_the_model(tmp_path, name):
    (tmp_path / "extended.yaml").write_text(yaml.safe_dump({"effects": [], name: "x"}))
    with pytest.raises(
        UserError,
        match=rf"extended\.yaml sets '{name}'; it may set string, effects, parameter_values",
    ):
        read_extended_model(tmp_path)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("effects: null", "effects in extended.yaml must hold a list"),
        ("effects: tip_mass", "effects in extended.yaml must hold a list"),
        ("string: [1]", "string in extended.yaml must hold names and values"),
        ("parameter_values: !!set {wind}", "not valid YAML"),
    ],
)
def test_malformed_extended_model_is_refused(tmp_path, said, message):
    (tmp_path / "extended.yaml").write_text(said)
    with pytest.raises(UserError, match=message):
        read_extended_model(tmp_path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["string.points=1000000000"],
            r"string\.points = 1e\+09 .* from 2 to 10000",
        ),
        (
            ["effects=[" + ",".join(["wind"] * 101) + "]"],
            "There are 101 effects; at most 100",
        ),
    ],
)
def test_huge_or_invalid_values_are_refused(words, message):
    """Examples: 2 TB of memory, and loops of 3000 effects."""
    with pytest.raises(UserError, match=message):
        prepare_experiment(resolve_settings(*words), lambda block: block)


@pytest.mark.parametrize(
    "name",
    [
        "arm",
        "camera",
        "target",
        "obstacles",
        "parameter_values",
        "string",
        "string.ranges",
        "string.integrator",
        "obstacles.boxes",
        "saved_outputs",
        "string.tolerance",
        "trials",
        "model_from",
    ],
)
def test_malformed_setting_is_refused_by_name(settings, name):
    for value in (5, [5], [[]]):
        with pytest.raises(UserError, match=name.replace(".", r"\.")):
            prepare_experiment(poisoned(settings, name, value), lambda block: block)


@pytest.mark.parametrize("value", [10**400, 1e300])
def test_parameter_values_have_an_upper_bound(settings, value):
    known = {"bending_stiffness": value}
    with pytest.raises(UserError, match="parameter_values"):
        prepare_experiment(settings | {"parameter_values": known}, lambda block: block)


def test_parameter_values_are_finite():
    settings = resolve_settings("effects=[tip_mass]") | {
        "parameter_values": {"tip_mass.ratio": float("nan")}
    }
    with pytest.raises(
        UserError, match=r"parameter_values\.tip_mass\.ratio = nan .* from -1e\+12"
    ):
        prepare_experiment(settings, lambda block: block)


def test_log_is_not_written_through_a_link(tmp_path):
    """A foreign run could append them to any file of the user."""
    precious, run = tmp_path / "precious", tmp_path / "run"
    run.mkdir()
    precious.write_text("mine")
    (run / "run.log").symlink_to(precious)
    with log.log_to_folder(run):
        log.LOGGER.info("a line")
    assert precious.read_text() == "mine"
    (run / "run.log").unlink()
    with log.log_to_folder(run):
        log.LOGGER.info("a line")
    assert "a line" in (run / "run.log").read_text()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="only POSIX has named pipes")
def test_log_that_is_a_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "run.log")
    with log.log_to_folder(tmp_path):
        log.LOGGER.info("a line")


@pytest.mark.parametrize("name", ["iterations", "iterations/01/trial", "config.json"])
def test_run_folder_with_a_link_is_refused(tmp_path, name):
    """Steps could be written, and folders removed, through the link."""
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    (elsewhere / "images").mkdir(parents=True)
    (run / name).parent.mkdir(parents=True)
    (run / name).symlink_to(elsewhere)
    with (
        pytest.raises(DataError, match=f"{name}: a run's folder holds no links"),
        run_folder.exclusive_access(run),
    ):
        pytest.fail("the run began")
    assert (elsewhere / "images").is_dir()
    assert [path.name for path in elsewhere.iterdir()] == ["images"]


def test_settings_of_a_run_name_no_file_to_write(tmp_path):
    """Otherwise `resume` could overwrite any file of the user."""
    precious = tmp_path / "precious"
    precious.write_text("mine")
    config = resolve_settings("hardware=emulator")
    config["hardware"]["record"] = str(precious)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(json.dumps(config))
    with pytest.raises(UserError, match=r"hardware\.record"):
        load_command("resume")([str(tmp_path / "run")])
    assert precious.read_text() == "mine"


@pytest.mark.parametrize("read", [read_extended_model, read_measured_camera])
def test_interpolations_are_refused(tmp_path, read):
    for file in ("extended.yaml", "camera.yaml"):
        (tmp_path / file).write_text("parameter_values: {a: [1, '${oc.env:HOME}']}\n")
    with pytest.raises(UserError, match=r"parameter_values\.a\.1 holds '\$\{'"):
        read(tmp_path)


def test_empty_model_is_refused(tmp_path):
    """Otherwise the run would use the default string."""
    (tmp_path / "extended.yaml").write_text("")
    with pytest.raises(UserError, match=r"extended\.yaml is empty"):
        read_extended_model(tmp_path)


def test_interpolations_in_settings_of_trials_are_refused(settings, tmp_path):
    (tmp_path / "config.json").write_text(
        json.dumps({**settings, "estimate": {"beta": "${oc.env:HOME}"}})
    )
    config = OmegaConf.create({**settings, "trials": str(tmp_path)})
    with pytest.raises(DataError, match=r"estimate\.beta holds"):
        inherit_settings(config, set())


def test_allowed_callables_exist_and_cover_our_settings():
    for role, names in allowed_callables.allowed_names_by_role().items():
        for name in names:
            assert callable(load_callable(name, role, ""))
    for file in CONF_FOLDER.rglob("*.yaml"):
        group = file.parent.relative_to(CONF_FOLDER).as_posix()
        chosen = yaml.safe_load(file.read_text()) or {}
        if group in allowed_callables.allowed_names_by_role() and "_target_" in chosen:
            assert (
                chosen["_target_"] in allowed_callables.allowed_names_by_role()[group]
            ), file


@pytest.mark.parametrize(
    "target", ["os.system", "stages.generate", None, ["x"], {"a": 1}]
)
def test_forbidden_callable_is_not_imported(target, monkeypatch):
    monkeypatch.setattr(
        "stringcast.pipeline.settings.typed_settings.load_object",
        lambda name: pytest.fail(f"{name} was looked up"),
    )
    for role in (*allowed_callables.allowed_names_by_role(), "unheard_of"):
        with pytest.raises(UserError, match="may not be named here"):
            load_callable(target, f"a.{role}", "file")


def test_real_arm_does_not_move_with_foreign_limits(settings):
    real = resolve_settings("hardware=serial")
    faster = {**real, "arm": {**real["arm"], "hand_speed": 99.0}}
    with pytest.raises(
        UserError,
        match=r"arm\.hand_speed: 21\.8 here, 99\.0 there\n.*accept_limits=true",
    ):
        refuse_inherited_limits(faster, real, "trials=x")
    refuse_inherited_limits(faster, {**real, "accept_limits": True}, "trials=x")
    estimating, aligning = (
        {**faster, "mode": resolve_settings(f"mode={mode}")["mode"]}
        for mode in ("estimate", "align")
    )
    refuse_inherited_limits(estimating, real, "trials=x")
    # a motion is performed where no trials are stored
    with pytest.raises(UserError, match="accept_limits=true"):
        refuse_inherited_limits(aligning, real, "trials=x")
    refuse_inherited_limits({**aligning, "trials": "x"}, real, "trials=x")
    refuse_inherited_limits(real, real, "trials=x")


@pytest.mark.parametrize("block", ["arm", "hardware", "execute"])
def test_all_foreign_limits_need_consent(block):
    real = resolve_settings("hardware=serial")
    other = {**real, block: {**real[block], "added_by_others": 1.0}}
    with pytest.raises(
        UserError, match=rf"{block}\.added_by_others: absent here, 1\.0 there"
    ):
        refuse_inherited_limits(other, real, "trials=x")


def test_virtual_arm_needs_no_consent(settings):
    faster = {**settings, "arm": {**settings["arm"], "hand_speed": 99.0}}
    refuse_inherited_limits(faster, settings, "trials=x")


def test_resume_with_a_real_arm_needs_consent(settings, tmp_path):
    (tmp_path / "config.json").write_text(
        json.dumps(resolve_settings("hardware=serial"))
    )
    with pytest.raises(
        UserError, match=r"hardware\.port: .*/dev/ttyUSB0 there[\s\S]*--accept-limits"
    ):
        load_command("resume")([str(tmp_path)])
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


@pytest.fixture
def shared_folder(tmp_path, monkeypatch):
    """Return the folder of our compiled code among temporary files.

    Other users could have made it first.
    """
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("getpass.getuser", lambda: "ann")
    module_cache.private_temporary_folder.cache_clear()
    yield tmp_path / "stringcast-ann"
    module_cache.private_temporary_folder.cache_clear()


def test_machine_code_is_stored_in_a_private_folder(shared_folder):
    assert module_cache.private_temporary_folder() == shared_folder
    assert shared_folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("fault", ["open", "link", "others"])
def test_foreign_machine_code_is_not_run(shared_folder, tmp_path, monkeypatch, fault):
    if fault == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        shared_folder.symlink_to(tmp_path / "elsewhere")
    else:
        shared_folder.mkdir()
        shared_folder.chmod(0o777 if fault == "open" else 0o700)
    if fault == "others":
        monkeypatch.setattr("os.getuid", lambda: 4321, raising=False)
    used = module_cache.private_temporary_folder()
    assert used != shared_folder
    assert used.stat().st_mode & 0o777 == 0o700
    assert not list(used.iterdir())
    assert module_cache.private_temporary_folder() == used  # one folder for a process


def test_numpy_would_run_the_pickle(canary):
    """Show that the malicious pickle works."""
    np.load(poisons(canary)["generate"]["file"], allow_pickle=True)
    assert canary.exists()


@pytest.mark.parametrize(
    "given",
    [
        ("execute=dry", "execute=slow"),
        ("+experiment=quick", "+experiment=stringB"),
        ("seed=1", "estimate.beta=0.9", "seed=2"),
        ("source@plane=images", "source@plane=video"),
    ],
)
def test_setting_given_twice_is_refused(given):
    with pytest.raises(
        UserError, match=f"{given[0]} and {given[-1]} .*given twice".replace("+", r"\+")
    ):
        refuse_repeated_settings(given)
    with pytest.raises(UserError, match="given twice"):
        compose_settings(given)
    refuse_repeated_settings(
        [
            "source=images",
            "source@plane=video",
            "seed=1",
            "source.folder=x",
            "~obstacles",
            "obstacles=none",
        ]
    )
