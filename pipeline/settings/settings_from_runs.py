"""Settings that a folder brings along: of stored trials, or the model that a diagnosis
or an alignment made.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from stringcast.data.file_checks import read_json, read_yaml, refuse_interpolation
from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.pipeline.settings.allowed_callables import VIRTUAL_HARDWARE
from stringcast.pipeline.settings.composition import (
    UserError,
    flatten_settings,
    setting_names,
)
from stringcast.pipeline.settings.typed_settings import build_chosen, require_allowed
from stringcast.stages.calibrate import CAMERA
from stringcast.stages.spec import EXTENDED

# what an extended model may set, and as what
MODEL_SETTINGS = {"string": dict, "effects": list, "parameter_values": dict}
# how an arm may move: a person's own word, where it is real
ARM_BLOCKS = ("arm", "hardware", "execute")
# that of the string that was measured, however it is simulated
LENGTH_SETTING = "string.length"
# as a share, of what a balance says: so closely what hangs at the tip is known
WEIGHING_UNCERTAINTY = 1e-3
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
)  # settings that stored trials bring along


def inherit_settings(config: DictConfig, given: set[str]) -> dict[str, Any]:
    """All settings. Folders of trials, of a model and of a calibration bring some
    along, and the later of these stands.

    given: names on the command line, which stand above all.
    """
    # unresolved: what refers to a setting follows it
    whole = OmegaConf.create(OmegaConf.to_container(config))
    brought = (
        {} if config.trials is None else settings_of_trials(Path(config.trials), given)
    )
    for name, value in brought.items():
        OmegaConf.update(whole, name, value, merge=False)
    if config.model_from is not None:
        for name, value in read_extended_model(Path(config.model_from)).items():
            OmegaConf.update(whole, name, value, merge=True)
    if config.camera_from is not None:
        OmegaConf.update(
            whole, "camera", read_measured_camera(Path(config.camera_from)), merge=False
        )
    if any(
        folder is not None
        for folder in (config.trials, config.model_from, config.camera_from)
    ):
        restore_given_settings(whole, config, given)
    if LENGTH_SETTING in brought:
        OmegaConf.update(whole, LENGTH_SETTING, brought[LENGTH_SETTING])
    if config.trials is not None and not (Path(config.trials) / "config.json").exists():
        # what dataset.yaml says was weighed at the string's tip hangs at the model's:
        # it is known, and not fitted
        string = read_metadata(Path(config.trials)).get("string", {})
        if string.get("tip_mass"):
            ratio = float(string["tip_mass"]) / float(string["mass"])
            whole.effects = [*whole.effects, *({"tip_mass"} - {*whole.effects})]
            weighed = {
                "value": ratio,
                "low": (1 - WEIGHING_UNCERTAINTY) * ratio,
                "high": (1 + WEIGHING_UNCERTAINTY) * ratio,
            }
            # what was said of it elsewhere stands above
            whole.parameter_values = {
                "tip_mass.ratio": weighed,
                **whole.parameter_values,
            }
    settings: Any = OmegaConf.to_container(whole, resolve=True)
    return dict(settings)


def restore_given_settings(whole: Any, config: DictConfig, given: set[str]) -> None:
    """Set the settings that a person gave, by their names, to what they are in
    `config`: they stand above all.
    """
    for name in sorted(given & set(setting_names(OmegaConf.to_container(config)))):
        OmegaConf.update(whole, name, OmegaConf.select(config, name))


def refuse_inherited_limits(
    settings: Any, own: Any, source: str, word: str = "accept_limits=true"
) -> None:
    """Refuse to move a real arm by what a folder says of its limits, unless a person
    has agreed to it.

    settings: of the run; own: as they are configured here. word: how to agree. Raises
    UserError with what differs.
    """
    virtual = (
        require_allowed(settings["hardware"].get("_target_"), "hardware", "hardware")
        in VIRTUAL_HARDWARE
    )
    if own["accept_limits"] or virtual or not run_moves_arm(settings):
        return
    theirs, ours = (
        {name: flatten_settings(block[name]) for name in ARM_BLOCKS}
        for block in (settings, own)
    )
    differing = [
        f"{name}.{key}: {ours[name].get(key, 'absent')} here, {theirs[name].get(key, 'absent')} there"
        for name in ARM_BLOCKS
        for key in sorted({*theirs[name], *ours[name]})
        if ours[name].get(key) != theirs[name].get(key)
    ]
    if differing:
        listed = "\n  ".join(differing)
        raise UserError(
            f"{source}: a real arm would move by limits and driving that this folder brings along:\n  {listed}\n"
            f"Nothing was moved. Look at them; then give {word}, or name your own (arm=..., hardware=..., execute=...)."
        )


def run_moves_arm(settings: Any) -> bool:
    """Whether a run with these settings moves an arm, real or not."""
    return bool(build_chosen(settings["mode"], "mode", "conf/mode").moves_arm(settings))


def read_extended_model(folder: Path) -> dict[str, Any]:
    """Settings of the model that a run made: `string`, `effects`, `parameter_values`. folder: of a
    diagnosis or an alignment.
    """
    made = read_run_settings(
        folder,
        EXTENDED,
        "model_from",
        "Name the run folder of a diagnosis or an alignment.",
    )
    for name, value in made.items():
        if name not in MODEL_SETTINGS:
            raise UserError(
                f"model_from={folder}: {EXTENDED} sets {name!r}; it may set {', '.join(MODEL_SETTINGS)}. Remove it."
            )
        if not isinstance(value, MODEL_SETTINGS[name]):
            kind = "a list" if MODEL_SETTINGS[name] is list else "names and values"
            raise UserError(
                f"model_from={folder}: {name} in {EXTENDED} must hold {kind}. Correct or remove it."
            )
    return made


def read_measured_camera(folder: Path) -> dict[str, Any]:
    """The camera that a calibration measured, as settings. folder: the calibration's
    run, or the file itself.
    """
    return read_run_settings(
        folder, CAMERA, "camera_from", "Name the run folder of a good calibration."
    )


def read_run_settings(
    folder: Path, file: str, setting: str, remedy: str
) -> dict[str, Any]:
    """Settings that a run left in a file, given by a setting as its folder or the file
    itself. Raises UserError.
    """
    path = folder / file if folder.is_dir() else folder
    try:
        return read_yaml(path)
    except DataError as error:
        raise UserError(f"{setting}={folder}: {error} {remedy}") from error


def settings_of_trials(folder: Path, given: set[str]) -> dict[str, Any]:
    """Settings of stored trials, by name: those of a run of ours, or what another's
    dataset.yaml says.

    given: names on the command line; a group that is chosen there is not brought along,
    but for the string's length.
    """
    if (folder / "config.json").exists():
        known = read_json(folder / "config.json")
        brought = refuse_interpolation(
            {name: known[name] for name in RUN_SETTINGS if name in known},
            folder / "config.json",
        )
        brought |= (
            {LENGTH_SETTING: known["string"]["length"]} if "string" in known else {}
        )
    else:
        about = {
            group: values
            for group, values in read_metadata(folder).items()
            if group in DATASET_SETTINGS
        }
        brought = {
            f"{group}.{key}": value
            for group, values in about.items()
            for key, value in values.items()
            if key in DATASET_SETTINGS[group] and value is not None
        }
    # what the command line says itself is not taken; string=... says how a string is
    # simulated, not how long it is
    said = {
        name
        for name in brought
        if name in given or (name != LENGTH_SETTING and name.partition(".")[0] in given)
    }
    return {name: value for name, value in brought.items() if name not in said}


def refuse_unknown_bench(folder: Path, given: set[str]) -> None:
    """Refuse to move an arm for trials of which nobody says that they were made with
    it.
    """
    if not (folder / "config.json").exists() and "hardware" not in given:
        raise UserError(
            f"trials={folder}: these trials do not say on which bench they were made, so the arm will not be moved. "
            "Give hardware=serial or hardware=virtual if they were made there, or ask +experiment=diagnose alone."
        )
