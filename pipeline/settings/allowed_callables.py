"""The allowed values of the setting `_target_` for each role.

Settings may come from foreign folders (`trials=`, `model_from=`, `camera_from=`,
`resume`, `index` ...), so a name is looked up here before anything is imported. Within
`stringcast`, each room lists its names in `entry_points`, and a stage states those of
its role.

A plugin adds the public functions or classes of the modules in its folder of the role's
name, such as `my_lab/estimate/`.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping

from stringcast.hardware import entry_points as hardware_entry_points
from stringcast.pipeline import entry_points as pipeline_entry_points
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages import entry_points as stage_entry_points
from stringcast.stages.plugins import plugin_files, public_definitions

ROLES: Mapping[str, tuple[str, ...]] = {
    **hardware_entry_points.ROLES,
    **pipeline_entry_points.ROLES,
    **stage_entry_points.ROLES,
}
CLASS_ROLES = ("mode", "source", "plane")  # the other roles need functions


def allowed_names_by_role() -> dict[str, tuple[str, ...]]:
    """Return the allowed names in the package of each role, the settings block."""
    return {**ROLES, **{stage.name: stage.by for stage in stages().values()}}


def plugin_names(role: str) -> list[str]:
    """Return the allowed names in plugins for a role, without importing."""
    kind = ast.ClassDef if role in CLASS_ROLES else ast.FunctionDef
    names = []
    for file, module in plugin_files(role_files(role)).items():
        names += [f"{module}.{name}" for name in public_definitions(file, kind)]
    return names


def plugin_function_files() -> list[str]:
    """Return all modules of plugins for a role."""
    modules: dict[str, None] = {}
    for role in plugin_roles():
        modules |= dict.fromkeys(plugin_files(role_files(role)).values())
    return [*modules]


def plugin_roles() -> list[str]:
    """Return the roles that a plugin may extend."""
    by_stages = [stage.name for stage in stages().values() if stage.by]
    return [*by_stages, "hardware", *CLASS_ROLES]


def role_files(role: str) -> str:
    """Return the pattern of a plugin's files for a role; a plane is a source, too."""
    return f"{'source' if role == 'plane' else role}/*.py"
