"""The model of a run from its settings: arm, camera, string, effects and values."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.pipeline.settings.typed_settings import (
    build_dataclass,
    load_callable,
    require_block,
    validate_value,
)
from stringcast.stages.generate.curves import plain_cast
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.engine.accuracy import (
    ToleranceError,
    find_converged_string,
)
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.library import effect_files, find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.string import String

BlockLocation = Callable[[str], str]  # returns the file of a block
MEASURED_PARTS = ("value", "low", "high")  # parts of a parameter with an interval


def build_model(config: Settings, where: BlockLocation) -> Model:
    """Build the model of a run from all its settings.

    `where` returns the file of a block of settings, for messages. Raises UserError for
    a setting that cannot be used.
    """
    arm = build_dataclass(Arm, config["arm"], "arm", where("arm"))
    string = build_string(config["string"], where("string"))
    string = refine_string_to_tolerance(string, arm, config, where("string"))
    camera = build_dataclass(Camera, config["camera"], "camera", where("camera"))
    bare_model = Model(string, arm, camera)
    model = add_effects(bare_model, config["effects"], where("effects"))
    setting = "effects_per_recording"
    add_effects(bare_model, config[setting], where(setting), setting)  # only checked
    values = config["parameter_values"]
    start_values, measured_ranges = read_parameter_values(
        values, model, where("parameter_values")
    )
    return replace(model, start_values=start_values, measured_ranges=measured_ranges)


def add_effects(
    model: Model, names: Any, where: str, setting: str = "effects"
) -> Model:
    """Return the model with the effects that a setting names.

    Raises UserError for anything but a list of names, an unknown effect, or effects
    that exclude each other.
    """
    if not isinstance(names, list):
        fault = "it must be a list, such as [rest_curvature]"
        raise UserError(f"{setting} = {names!r} ({where})", fault, "Change it.")
    try:
        return model.with_effects(*find_effects([str(name) for name in names]))
    except ValueError as error:
        raise UserError(f"{setting} ({where})", str(error)) from error


def read_parameter_values(
    block: Settings, model: Model, where: str
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Read the setting `parameter_values`.

    Returns the value of each given parameter, and both ends of each measured one.
    """
    values = {}
    ranges = {}
    for name, value in flatten_parameters(block, where).items():
        setting = f"parameter_values.{name}"
        if name not in model.names:
            remedy = unknown_parameter_remedy(name, model)
            fault = "the model has no such parameter"
            raise UserError(f"{setting} ({where})", fault, f"{remedy}.")
        is_measured = isinstance(value, Mapping) and set(value) == {*MEASURED_PARTS}
        numbers = [value[part] for part in MEASURED_PARTS] if is_measured else [value]
        if not all(is_finite_number(number) for number in numbers):
            fault = "it must be a number, or value, low and high"
            raise UserError(f"{setting} = {value!r} ({where})", fault, "Change it.")
        values[name] = float(numbers[0])
        if is_measured:
            best, low, high = numbers
            if not (low < high and low <= best <= high):
                fault = f"low = {low} < high = {high} must enclose value = {best}"
                raise UserError(f"{setting} ({where})", fault, "Change it.")
            ranges[name] = float(low), float(high)
    return values, ranges


def flatten_parameters(block: Settings, where: str) -> dict[str, Any]:
    """Return the given values by full parameter name.

    On the command line, +parameter_values.tip_mass.ratio=0.05 is a nested block.
    """
    given: dict[str, Any] = {}
    for name, value in require_block(block, "parameter_values", where).items():
        if isinstance(value, Mapping) and "value" not in value:
            for inner_name, inner_value in value.items():
                given[f"{name}.{inner_name}"] = inner_value
        else:
            given[name] = value
    return given


def is_finite_number(value: Any) -> bool:
    """Return whether a value is a finite number that a float can hold."""
    return isinstance(value, float | int) and abs(value) <= sys.float_info.max


def unknown_parameter_remedy(name: str, model: Model) -> str:
    """Describe how to add the effect of a parameter, or list the known ones."""
    effect = name.partition(".")[0]
    if effect in effect_files():
        value = f"'+parameter_values.{effect}.<parameter>=<number>'"
        return f"Model it: 'effects=[{effect}]' {value}"
    return f"Known are: {', '.join(model.names)}"


def build_string(block: Settings, where: str) -> String:
    """Build the string model with the ranges of its parameters."""
    fields = dict(require_block(block, "string", where))
    limits_by_name = require_block(fields.pop("ranges"), "string.ranges", where)
    integrator_block = fields.pop("integrator")
    choice = require_block(integrator_block, "string.integrator", where)
    del fields["tolerance"]
    string = build_dataclass(String, fields, "string", where)
    integrator = load_callable(choice.get("_target_"), "string.integrator", where)
    if len(choice) > 1:
        setting = f"string.integrator = {dict(choice)} ({where})"
        raise UserError(setting, "it must hold only `_target_`", "Change it.")

    known = {parameter.name: parameter for parameter in string.parameters}
    ranges = {}
    for name, limits in limits_by_name.items():
        setting = f"string.ranges.{name}"
        if name not in known:
            fault = "there is no such parameter"
            raise UserError(
                f"{setting} ({where})",
                fault,
                f"Known are: {', '.join(known)}.",
            )
        ranges[name] = read_range(known[name], limits, setting, where)
    return replace(string, ranges=ranges, integrator=integrator())


def read_range(
    parameter: Parameter, limits: Mapping[str, Any], setting: str, where: str
) -> Parameter:
    """Return a parameter with the range and start value of a setting."""
    low = validate_value(float, limits["low"], f"{setting}.low", where)
    high = validate_value(float, limits["high"], f"{setting}.high", where)
    start = validate_value(float, limits["start"], f"{setting}.start", where)
    if not low < high:
        fault = f"low = {low} must be below high = {high}"
        raise UserError(f"{setting} ({where})", fault, "Change one.")
    if not low <= start <= high:
        fault = f"it must lie from {low} to {high}"
        raise UserError(f"{setting}.start = {start} ({where})", fault, "Change it.")
    return replace(parameter, low=low, high=high, start=start)


def refine_string_to_tolerance(
    string: String, arm: Arm, config: Settings, where: str
) -> String:
    """Return the string with points and step for `string.tolerance`, if given.

    The error is measured on one plain cast, with all parameters in mid-range.
    """
    tolerance = config["string"]["tolerance"]
    if tolerance is None:
        return string
    tolerance = validate_value(float, tolerance, "string.tolerance", where)
    setting = f"string.tolerance = {tolerance!r} ({where})"

    durations = config["generate"]["shortest"] * config["generate"]["longest"]
    cast = plain_cast(arm, float(np.sqrt(durations)))
    samples = cast.sample(arm.tick, float(cast.duration[0]))
    hand = JointMotion(0.0, arm.tick, *samples).hand_motion(arm)
    middle = np.array([p.value(np.array(0.5)) for p in string.parameters])
    try:
        return find_converged_string(string, hand, middle, tolerance).string
    except ToleranceError as error:
        raise UserError(setting, str(error)) from error
