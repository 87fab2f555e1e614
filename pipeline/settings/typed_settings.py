"""Turn blocks of settings into checked objects and functions."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

from stringcast.data.errors import suggest_known_name
from stringcast.pipeline.settings.allowed_callables import (
    CLASS_ROLES,
    allowed_names_by_role,
    plugin_names,
    plugin_roles,
)
from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.stages.common import SettingsGroup
from stringcast.stages.plugins import PLUGIN_PREFIX, load_object, plugin_folders

BuiltT = TypeVar("BuiltT")
# arguments supplied by the run
RUN_ARGUMENTS = ("seed", "cast_number", "trial", "progress")
# settings that name a folder or are null
PATH_SETTINGS = ("trials", "model_from", "camera_from")
# settings of a stage's block that are not arguments
RUN_SETTINGS = ("_target_", "inputs")


def bind_stage(block: Settings, place: str, where: str) -> Callable[..., Any]:
    """Return the function of a block, with its checked settings bound.

    The block holds ``_target_``, and exactly the function's keyword-only arguments (for
    a `SettingsGroup`, its fields), without those supplied by the run. `place` is its
    name, and `where` its file, for messages. Raises UserError for a name or value that
    the function does not accept.
    """
    target = require_target(block, place, where, f"+{place}=...")
    function = load_callable(target, place, where)
    refuse_other_inputs(function, target, place, where)
    types = setting_types(function)
    given = {name: value for name, value in block.items() if name not in RUN_SETTINGS}
    check_names(given, types, place, where)

    arguments = {
        name: validate_value(kind, given[name], f"{place}.{name}", where)
        for name, kind in types.items()
    }
    for name, kind in keyword_types(function).items():
        if is_settings_group(kind):
            field_values = {
                field: arguments.pop(field) for field in get_type_hints(kind)
            }
            arguments[name] = kind(**field_values)
    return functools.partial(function, **arguments)


def refuse_other_inputs(
    function: Callable[..., Any], name: str, place: str, where: str
) -> None:
    """Raise UserError for a plugin's function with a wrong number of artifacts.

    It must accept as many as the package's functions of this role.
    """
    own_names = allowed_names_by_role().get(place, ())
    if not name.startswith(PLUGIN_PREFIX) or not own_names:
        return
    wanted = positional_names(load_object(own_names[0]))
    if len(positional_names(function)) != len(wanted) and not takes_any(function):
        raise UserError(
            f"{place}._target_ = {name} ({where})",
            f"it takes ({', '.join(positional_names(function))}), but the stage "
            f"gives it ({', '.join(wanted)})",
            "Correct the function's positional arguments.",
        )


def takes_any(function: Callable[..., Any]) -> bool:
    """Return whether a function accepts any number of positional arguments."""
    parameters = inspect.signature(function).parameters.values()
    return any(p.kind is inspect.Parameter.VAR_POSITIONAL for p in parameters)


def positional_names(function: Callable[..., Any]) -> list[str]:
    """Return the names of the positional arguments of a function."""
    parameters = inspect.signature(function).parameters.values()
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return [p.name for p in parameters if p.kind in kinds]


def setting_types(kind: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of the settings of a function or class."""
    if inspect.isclass(kind):
        return get_type_hints(kind, include_extras=True)
    types: dict[str, Any] = {}
    for name, hint in keyword_types(kind).items():
        if is_settings_group(hint):
            types |= get_type_hints(hint, include_extras=True)
        else:
            types[name] = hint
    return types


def keyword_types(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of keyword-only arguments not supplied by the run."""
    place = f"{function.__module__}.{function.__name__}"
    try:
        hints = get_type_hints(function, include_extras=True)
    except (NameError, TypeError) as error:
        raise UserError(place, f"a type is wrong ({error})", "Correct it.") from error
    types = {}
    for name, parameter in inspect.signature(function).parameters.items():
        is_keyword = parameter.kind is inspect.Parameter.KEYWORD_ONLY
        if is_keyword and name not in RUN_ARGUMENTS:
            if name not in hints:
                raise UserError(
                    place,
                    f"its argument {name} must state a type, such as `float`",
                    "Add it.",
                )
            types[name] = hints[name]
    return types


def is_settings_group(hint: Any) -> bool:
    """Return whether a type is a dataclass whose fields are settings."""
    return isinstance(hint, type) and issubclass(hint, SettingsGroup)


def build_dataclass(
    kind: type[BuiltT], block: Settings, place: str, where: str
) -> BuiltT:
    """Build a validated dataclass from a block of its fields."""
    require_block(block, place, where)
    check_names(block, expected_fields(kind, block), place, where)
    return validate_value(kind, block, place, where)


def refuse_odd_paths(settings: Mapping[Any, Any], where: str) -> None:
    """Raise UserError for a folder setting that is not text."""
    for name in PATH_SETTINGS:
        value = settings[name]
        if value is not None and not isinstance(value, str):
            raise UserError(
                f"{name} = {value!r} ({where})",
                "it must be the path of a folder",
                f"Write {name}=./<folder>.",
            )


def require_block(block: Any, place: str, where: str) -> Settings:
    """Return a block of settings; raise UserError if it is no block."""
    if not isinstance(block, Mapping):
        raise UserError(
            f"{place} = {block!r} ({where})",
            "it must hold names and values",
            "Change it.",
        )
    return block


def require_target(block: Any, place: str, where: str, option: str) -> Any:
    """Return the `_target_` of a block; raise UserError if it has none.

    option: alternative to offer in the message.
    """
    if not isinstance(block, Mapping) or "_target_" not in block:
        raise UserError(
            f"{place} = {block!r} ({where})",
            "it must hold `_target_` and its settings",
            f"Choose {option}",
        )
    return block["_target_"]


def expected_fields(kind: Any, block: Settings) -> list[str]:
    """Return the fields of a dataclass that a block has or must have."""
    names = []
    for field in fields(kind):
        is_required = field.default is MISSING and field.default_factory is MISSING
        if is_required or field.name in block:
            names.append(field.name)
    return names


def check_names(
    given: Iterable[str], expected: Iterable[str], place: str, where: str
) -> None:
    """Raise UserError for the first setting that is unknown or missing."""
    expected = list(expected)
    for name in given:
        if name not in expected:
            raise UserError(
                f"{place}.{name} ({where})",
                "there is no such setting",
                suggest_known_name(name, expected),
            )
    for name in expected:
        if name not in given:
            raise UserError(
                f"{place}.{name} ({where})",
                "the setting is missing",
                "Give it a value.",
            )


def load_callable(target: Any, place: str, where: str) -> Any:
    """Return the function or class of an allowed `_target_`."""
    name = require_allowed(target, place, where)
    found = load_object(name)
    role = place.rpartition(".")[2]
    if name.startswith(PLUGIN_PREFIX) and role in CLASS_ROLES:
        base = common_base([load_object(own) for own in allowed_names_by_role()[role]])
        if not (is_dataclass(found) and issubclass(found, base)):  # type: ignore[arg-type]
            raise UserError(
                f"{place}._target_ = {name} ({where})",
                "it must be a dataclass that derives from "
                f"{base.__module__}.{base.__name__}",
                "Correct the class.",
            )
    return found


def common_base(kinds: list[type]) -> type:
    """Return the nearest common base class."""
    for base in kinds[0].__mro__:
        if all(issubclass(kind, base) for kind in kinds):
            return base
    return object


def require_allowed(target: Any, place: str, where: str) -> str:
    """Return an allowed `_target_`; raise UserError for any other.

    `place` is the full name of the setting, such as ``string.integrator``; its last
    name is the role. `where` is its file, for messages.
    """
    role = place.rpartition(".")[2]
    allowed_names = [*allowed_names_by_role().get(role, ())]
    if role in plugin_roles():
        allowed_names += plugin_names(role)
    if target not in allowed_names:
        raise UserError(
            f"{place}._target_ = {target!r} ({where})",
            "it may not be named here",
            remedy_for_target(target, allowed_names),
        )
    return str(target)


def remedy_for_target(target: Any, allowed_names: list[str]) -> str:
    """Describe what to name instead of a `_target_`, or how to name its plugin."""
    if not allowed_names:
        return "Remove it: no code can be chosen here."
    if isinstance(target, str) and target.startswith(PLUGIN_PREFIX):
        plugin = target.split(".")[1]
        if plugin not in plugin_folders():
            return (
                f"You have not named the plugin {plugin!r}. If you trust its code, "
                f"give 'plugins=[{plugin}]', or set STRINGCAST_PLUGINS."
            )
        if near := difflib.get_close_matches(target, allowed_names, 1):
            return f"Did you mean {near[0]!r}?"
    return f"Choose {' or '.join(allowed_names)}."


def build_chosen(block: Settings, place: str, where: str) -> Any:
    """Build an object of the class in a block's `_target_`."""
    target = require_target(block, place, where, f"{place}=...")
    kind = load_callable(target, place, where)
    settings = {name: value for name, value in block.items() if name != "_target_"}
    return build_dataclass(kind, settings, place, where)


def validate_value(kind: Any, value: Any, place: str, where: str) -> Any:
    """Return a value as this type; raise UserError with the setting and the remedy."""
    if isinstance(value, Mapping) and "_target_" in value:
        value = build_chosen(value, place, where)
    pydantic_config: Any = {"arbitrary_types_allowed": True}
    if is_dataclass(kind):
        pydantic_config = None
        if isinstance(value, Mapping):
            check_names(value, expected_fields(kind, value), place, where)
    try:
        return TypeAdapter(kind, config=pydantic_config).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join([place, *map(str, first["loc"])])
        if not isinstance(first["input"], Mapping):
            name += f" = {first['input']!r}"
        fault = first["msg"].removeprefix("Value error, ")
        raise UserError(
            f"{name} ({where})",
            fault,
            "Change it there or on the command line.",
        ) from error
