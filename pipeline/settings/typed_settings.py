"""From configuration blocks to validated settings and objects, with errors a person can
act on.
"""

from __future__ import annotations

import copy
import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.utils import get_object
from omegaconf import OmegaConf
from pydantic import TypeAdapter, ValidationError

from stringcast.data.errors import ExpectedError
from stringcast.pipeline.settings.allowed_callables import allowed_names_by_role
from stringcast.stages.common import SettingsGroup

Built = TypeVar("Built")
CONF_FOLDER = Path(__file__).resolve().parents[2] / "conf"
RUN_ARGUMENTS = ("seed", "manipulation", "trial", "progress")


class UserError(ExpectedError):
    """A setting or an argument that cannot be used."""


def compose_settings(overrides: Sequence[str] = ()) -> Any:
    """All settings as configured, as plain values, outside a run. overrides: as on the
    command line.
    """
    return copy.deepcopy(_compose_cached(tuple(overrides)))


@functools.cache
def _compose_cached(overrides: tuple[str, ...]) -> Any:
    """The cached settings, not to be changed: Hydra takes 0.1 s, and each job of a
    study asks for the same.
    """
    refuse_repeated_settings(overrides)
    with initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        return OmegaConf.to_container(compose("config", list(overrides)))


def given_names(overrides: Iterable[str]) -> set[str]:
    """Names of the settings that overrides give."""
    return {override.split("=")[0].lstrip("+~") for override in overrides}


def refuse_repeated_settings(overrides: Iterable[str]) -> None:
    """Refuse a setting or a group that is given twice, of which Hydra would take the
    last in silence.
    """
    seen: dict[tuple[str, str | None], str] = {}
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        place = override.key_or_group, override.package
        if override.is_delete():
            continue
        if place in seen:
            raise UserError(
                f"{seen[place]} and {override.input_line} (command line): the setting is given twice. Leave one out."
            )
        seen[place] = str(override.input_line)


def setting_names(block: Any, place: str = "") -> Iterator[str]:
    """Names of all settings, with dots."""
    for name, value in block.items():
        yield f"{place}{name}"
        if isinstance(value, dict):
            yield from setting_names(value, f"{place}{name}.")


def flatten_settings(block: Any, place: str = "") -> dict[str, Any]:
    """Every value of nested settings by its full name."""
    if not isinstance(block, dict) or not block:
        return {place: block}
    return {
        name: value
        for key, inside in block.items()
        for name, value in flatten_settings(
            inside, f"{place}.{key}" if place else key
        ).items()
    }


def bind_stage(block: Mapping[str, Any], place: str, where: str) -> Callable[..., Any]:
    """The function a block names, with the block's settings checked and bound.

    place: name of the block; where: the file it comes from. The settings must be
    exactly the function's keyword-only arguments, or the fields of those that are a
    `SettingsGroup`, less what the run supplies.
    """
    function = load_callable(block["_target_"], place, where)
    groups = {
        name: kind
        for name, kind in keyword_types(function).items()
        if is_settings_group(kind)
    }
    flat = setting_types(function)
    given = {key: value for key, value in block.items() if key != "_target_"}
    check_names(given, flat, place, where)
    known = {n: validate_value(flat[n], given[n], f"{place}.{n}", where) for n in flat}
    for name, kind in groups.items():
        known[name] = kind(
            **{field: known.pop(field) for field in get_type_hints(kind)}
        )
    return functools.partial(function, **known)


def setting_types(kind: Callable[..., Any]) -> dict[str, Any]:
    """The type of each setting that a block takes which names this function or class."""
    if inspect.isclass(kind):
        return get_type_hints(kind, include_extras=True)
    inside = {
        name: get_type_hints(hint, include_extras=True)
        if is_settings_group(hint)
        else {name: hint}
        for name, hint in keyword_types(kind).items()
    }
    return {name: hint for one in inside.values() for name, hint in one.items()}


def keyword_types(function: Callable[..., Any]) -> dict[str, Any]:
    """Types of a function's keyword-only arguments, less what the run itself supplies."""
    hints = get_type_hints(function, include_extras=True)
    return {
        name: hints[name]
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        and name not in RUN_ARGUMENTS
    }


def is_settings_group(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, SettingsGroup)


def build_dataclass(
    kind: type[Built], block: Mapping[str, Any], place: str, where: str
) -> Built:
    """A validated dataclass from a block whose keys are its fields."""
    assert is_dataclass(kind)
    required = [f.name for f in fields(kind) if f.name in block or has_no_default(f)]
    check_names(block, dict.fromkeys(required), place, where)
    return validate_value(kind, block, place, where)


def has_no_default(field: Field[Any]) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def check_names(
    given: Mapping[str, Any], wanted: Mapping[str, Any], place: str, where: str
) -> None:
    """Refuse settings that are unknown or missing."""
    for name in given:
        if name not in wanted:
            near = difflib.get_close_matches(name, list(wanted), 1)
            hint = (
                f"Did you mean '{near[0]}'?"
                if near
                else f"Known are: {', '.join(wanted)}."
            )
            raise UserError(
                f"{place}.{name} ({where}): there is no such setting. {hint}"
            )
    for name in wanted:
        if name not in given:
            raise UserError(
                f"{place}.{name} ({where}): the setting is missing. Give it a value."
            )


def load_callable(target: Any, place: str, where: str) -> Any:
    """The function or class that fills a role; as `allowed`."""
    return get_object(f"stringcast.{require_allowed(target, place, where)}")


def require_allowed(target: Any, place: str, where: str) -> str:
    """The name of what fills a role. place: of the setting, whose last name is the
    role, such as `string.integrator`; where: the file it comes from. Raises UserError
    for a name that the role does not list.
    """
    known = allowed_names_by_role().get(place.rpartition(".")[2], ())
    if target not in known:
        choices = (
            f"Choose {' or '.join(known)}"
            if known
            else "Remove it: no code is chosen here"
        )
        raise UserError(
            f"{place}._target_ = {target!r} ({where}): it may not be named here. {choices}."
        )
    return str(target)


def build_chosen(block: Mapping[str, Any], place: str, where: str) -> Any:
    """The object of a class that a block names, one of several that fill the same role."""
    if not isinstance(block, Mapping) or "_target_" not in block:
        raise UserError(
            f"{place} = {block!r} ({where}): it must hold `_target_` and its settings. Choose {place}=..."
        )
    kind = load_callable(block["_target_"], place, where)
    return build_dataclass(
        kind,
        {name: value for name, value in block.items() if name != "_target_"},
        place,
        where,
    )


def validate_value(kind: Any, value: Any, place: str, where: str) -> Any:
    """`value` as `kind`, or an error that names the field, the file and the remedy."""
    if isinstance(value, Mapping) and "_target_" in value:
        value = build_chosen(value, place, where)
    if is_dataclass(kind) and isinstance(value, Mapping):
        check_names(
            value,
            {
                f.name: None
                for f in fields(kind)
                if f.name in value or has_no_default(f)
            },
            place,
            where,
        )
    try:
        return TypeAdapter(
            kind,
            config=None if is_dataclass(kind) else {"arbitrary_types_allowed": True},
        ).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join([place, *map(str, first["loc"])])
        remedy = first["msg"].removeprefix("Value error, ")
        if isinstance(first["input"], Mapping):
            raise UserError(
                f"{path} ({where}): {remedy}. Change it there or on the command line."
            ) from error
        raise UserError(
            f"{path} = {first['input']!r} ({where}): {remedy}. Change it there or on the command line."
        ) from error
