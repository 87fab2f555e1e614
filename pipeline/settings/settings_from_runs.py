"""Settings inherited from folders of trials, a model or a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from stringcast.data.file_checks import read_json, read_yaml, refuse_interpolation
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.hardware.entry_points import VIRTUAL_HARDWARE
from stringcast.pipeline.settings.composition import (
    PLUGINS_SETTING,
    UserError,
    flatten_settings,
    named_folders,
    setting_names,
)
from stringcast.pipeline.settings.named_plugins import require_named_plugins
from stringcast.pipeline.settings.typed_settings import build_chosen, require_allowed
from stringcast.stages.calibrate import CAMERA
from stringcast.stages.spec import EXTENDED

# settings of an extended model, with types
MODEL_SETTINGS = {"string": dict, "effects": list, "parameter_values": dict}
# limits of an arm, which a person must accept before a real arm moves
ARM_BLOCKS = ("arm", "hardware", "execute")
# The length belongs to the measured string, not to its simulation.
LENGTH_SETTING = "string.length"
# relative half width of the interval of a weighed tip mass
WEIGHING_UNCERTAINTY = 1e-3
# search range of a clock offset, in 95 % intervals
CLOCK_RANGE_FACTOR = 1.5
MAX_LAG_S = 0.05  # of an arm, by which a fitted offset may be too small
# settings inherited from dataset.yaml
DATASET_SETTINGS = {
    "string": ("length",),
    "arm": ("links", "base"),
    "camera": (
        "fps",
        "width",
        "height",
        "px_per_m",
        "origin_px",
        "distortion",
        "rotation",
        "tilt",
        "lens",
    ),
}
# settings inherited from stored trials of a run
RUN_SETTINGS = (
    "arm",
    "camera",
    "string",
    "effects",
    "parameter_values",
    "seed",
    "trials_used",
    "effects_per_recording",
    "estimate",
    "generate",
    "execute",
    "obstacles",
    "specimen",
    "hardware",
)


def inherit_settings(config: DictConfig, given: set[str]) -> dict[str, Any]:
    """Return all settings, including those inherited from folders.

    A calibrated camera replaces that of a model or of trials; a model replaces that of
    trials. The settings of the command line, whose names are `given`, take precedence
    over all others.
    """
    # not resolved yet, so that references follow changed settings
    merged: Any = OmegaConf.create(OmegaConf.to_container(config))
    inherited = {}
    if config.trials is not None:
        inherited = settings_of_trials(Path(config.trials), given)
    for name, value in inherited.items():
        OmegaConf.update(merged, name, value, merge=False)
    if config.model_from is not None:
        for name, value in read_extended_model(Path(config.model_from)).items():
            OmegaConf.update(merged, name, value, merge=True)
    if config.camera_from is not None:
        camera = read_measured_camera(Path(config.camera_from))
        OmegaConf.update(merged, "camera", camera, merge=False)

    restore_given_settings(merged, config, given)
    if LENGTH_SETTING in inherited:
        OmegaConf.update(merged, LENGTH_SETTING, inherited[LENGTH_SETTING])
    if config.trials is not None and not is_run_folder(Path(config.trials)):
        metadata = read_metadata(Path(config.trials))
        add_weighed_tip_mass(merged, metadata)
        add_clock_interval(merged, metadata)
    settings: Any = OmegaConf.to_container(merged, resolve=True)
    require_named_plugins(settings, "conf")
    return {**settings, PLUGINS_SETTING: named_folders()}


def restore_given_settings(merged: Any, config: DictConfig, given: set[str]) -> None:
    """Set the settings of the command line to their values in `config`."""
    for name in sorted(given & set(setting_names(OmegaConf.to_container(config)))):
        OmegaConf.update(merged, name, OmegaConf.select(config, name))


def add_weighed_tip_mass(merged: Any, metadata: dict[str, Any]) -> None:
    """Add the tip mass of dataset.yaml as an effect of known value."""
    string = metadata.get("string", {})
    if not string.get("tip_mass"):
        return
    ratio = float(string["tip_mass"]) / float(string["mass"])
    weighed = {
        "value": ratio,
        "low": (1 - WEIGHING_UNCERTAINTY) * ratio,
        "high": (1 + WEIGHING_UNCERTAINTY) * ratio,
    }
    add_measured_parameter(merged, "tip_mass.ratio", weighed)


def add_clock_interval(merged: Any, metadata: dict[str, Any]) -> None:
    """Add the clock offset of dataset.yaml as an effect with an interval.

    An offset that was fitted to the motion is too small by a lag of the arm.
    """
    clock = metadata.get("clock")
    if not clock:
        return
    middle = 0.5 * (clock["low"] + clock["high"])
    half_width = 0.5 * CLOCK_RANGE_FACTOR * (clock["high"] - clock["low"])
    is_fitted = "added" in clock
    offset = {
        "value": middle,
        "low": middle - half_width,
        "high": middle + half_width + (MAX_LAG_S if is_fitted else 0.0),
    }
    add_measured_parameter(merged, "time_offset.offset", offset)


def add_measured_parameter(merged: Any, name: str, measured: dict[str, float]) -> None:
    """Add a parameter's value, low and high to the settings, and its effect.

    A value that the settings already hold takes precedence.
    """
    effect = name.partition(".")[0]
    if effect not in merged.effects:
        merged.effects = [*merged.effects, effect]
    merged.parameter_values = {name: measured, **merged.parameter_values}


def is_run_folder(folder: Path) -> bool:
    """Return whether a folder of trials is a run, with its settings."""
    return (folder / "config.json").exists()


def refuse_inherited_limits(
    settings: Any, own_settings: Any, source: str, consent: str = "accept_limits=true"
) -> None:
    """Refuse to move a real arm with inherited limits without consent.

    `own_settings` are configured here. `source` and `consent` are the source of the
    limits and the option by which a person agrees, for the message. Raises UserError if
    limits differ; the message lists them.
    """
    hardware = settings["hardware"].get("_target_")
    is_virtual = require_allowed(hardware, "hardware", "hardware") in VIRTUAL_HARDWARE
    if own_settings["accept_limits"] or is_virtual or not run_moves_arm(settings):
        return
    differences = []
    for block in ARM_BLOCKS:
        theirs = flatten_settings(settings[block])
        ours = flatten_settings(own_settings[block])
        for name in sorted({*theirs, *ours}):
            if ours.get(name) != theirs.get(name):
                here, there = ours.get(name, "absent"), theirs.get(name, "absent")
                differences.append(f"\n  {block}.{name}: {here} here, {there} there")
    if differences:
        raise UserError(
            source,
            "a real arm would move by the limits of this "
            f"folder:{''.join(differences)}\nNothing was moved",
            f"Check them; then give {consent}, or choose your own (arm=..., "
            "hardware=..., execute=...).",
        )


def run_moves_arm(settings: Any) -> bool:
    """Return whether a run with these settings moves an arm, real or virtual."""
    return bool(build_chosen(settings["mode"], "mode", "conf/mode").moves_arm(settings))


def read_extended_model(folder: Path) -> dict[str, Any]:
    """Read the model of a diagnosis or an alignment, as settings.

    `folder` is that of the run, or the file itself. Raises UserError if the file is
    missing or holds anything but settings of a model.
    """
    remedy = "Name the run folder of a diagnosis or an alignment."
    model = read_run_settings(folder, EXTENDED, "model_from", remedy)
    for name, value in model.items():
        if name not in MODEL_SETTINGS:
            known_names = ", ".join(MODEL_SETTINGS)
            raise UserError(
                f"model_from={folder}",
                f"{EXTENDED} sets {name!r}; it may set {known_names}",
                "Remove it.",
            )
        if not isinstance(value, MODEL_SETTINGS[name]):
            kind = "a list" if MODEL_SETTINGS[name] is list else "names and values"
            raise UserError(
                f"model_from={folder}",
                f"{name} in {EXTENDED} must hold {kind}",
                "Correct or remove it.",
            )
    return model


def read_measured_camera(folder: Path) -> dict[str, Any]:
    """Read the camera measured by a calibration run, as settings."""
    remedy = "Name the run folder of a good calibration."
    return read_run_settings(folder, CAMERA, "camera_from", remedy)


def read_run_settings(
    folder: Path, file: str, setting: str, remedy: str
) -> dict[str, Any]:
    """Read settings from a file of a run; raise UserError that names the setting."""
    path = folder / file if folder.is_dir() else folder
    try:
        values = read_yaml(path)
    except DataError as error:
        raise UserError(f"{setting}={folder}", str(error), remedy) from error
    if not values:
        raise UserError(
            f"{setting}={folder}",
            f"{path} is empty",
            f"Restore it, or make it again. {remedy}",
        )
    return values


def settings_of_trials(folder: Path, given: set[str]) -> dict[str, Any]:
    """Return the settings of stored trials by name, from config.json or dataset.yaml.

    Settings of the command line are left out, and all settings of a group whose option
    it chooses. The length is an exception: `string=...` chooses the simulation of a
    string, not its length.
    """
    stored = {}
    if is_run_folder(folder):
        config = read_json(folder / "config.json")
        known = {name: config[name] for name in RUN_SETTINGS if name in config}
        stored = refuse_interpolation(known, folder / "config.json")
        if "string" in config:
            stored[LENGTH_SETTING] = config["string"]["length"]
    else:
        metadata = read_metadata(folder)
        for group, names in DATASET_SETTINGS.items():
            for name in names:
                value = metadata.get(group, {}).get(name)
                if value is not None:
                    stored[f"{group}.{name}"] = value

    for name in list(stored):
        group_is_given = name.partition(".")[0] in given and name != LENGTH_SETTING
        if name in given or group_is_given:
            del stored[name]
    return stored


def refuse_unknown_bench(folder: Path, given: set[str]) -> None:
    """Refuse to move an arm unless the stored trials are known to come from it."""
    if not is_run_folder(folder) and "hardware" not in given:
        raise UserError(
            f"trials={folder}",
            "the dataset does not state which arm and camera made its trials, "
            "so the arm will not be moved",
            "Give hardware=serial or hardware=virtual if they did, or run "
            "+experiment=diagnose.",
        )
