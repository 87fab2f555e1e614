"""The names that a setting `_target_` may hold, role by role.

Settings come from other people's folders too (`trials=`, `model_from=`, `camera_from=`,
`resume`, `index` ...), so a name is looked up here before anything is imported. Names
are those within the package `stringcast`. An arm, a camera or a mode of your own needs
its line here. A stage states itself what may fill its role.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from stringcast.pipeline.settings.stage_registry import stages

PICTURE_SOURCES = (
    "hardware.camera.Device",
    "hardware.camera.ImageFolder",
    "hardware.camera.VideoFile",
)
DRY_RUNS = ("stages.execute.dry_run.dry_run", "stages.execute.dry_run.slow_run")
# These move nothing real.
VIRTUAL_HARDWARE = ("hardware.virtual.open_lab", "hardware.serial.rehearsal.open_lab")
PIPELINE_ROLES: Mapping[str, tuple[str, ...]] = {
    "mode": (
        "pipeline.modes.Cast",
        "pipeline.modes.EstimateTrials",
        "pipeline.modes.Batch",
        "pipeline.modes.Diagnose",
        "pipeline.modes.Calibrate",
    ),
    "hardware": (
        *VIRTUAL_HARDWARE,
        "hardware.serial.lab.open_lab",
        "hardware.dynamixel.lab.open_lab",
    ),
    "source": PICTURE_SOURCES,  # of pictures
    "plane": PICTURE_SOURCES,
    "integrator": (
        "stages.model.engine.integrators.SemiImplicitEuler",
        "stages.model.engine.integrators.RungeKutta4",
        "stages.model.engine.implicit_leapfrog.ImplicitLeapfrog",
    ),
    "launcher": (
        "pipeline.sweep.launchers.serial",
        "pipeline.sweep.launchers.joblib",
        "pipeline.sweep.launchers.ray",
        "pipeline.sweep.launchers.slurm",
    ),
    "finish": ("pipeline.sweep.finish.finish", "pipeline.paper.finish.finish"),
}


@cache
def allowed_names_by_role() -> dict[str, tuple[str, ...]]:
    """Return the allowed names of each role, by the name of the settings block."""
    return {**PIPELINE_ROLES, **{stage.name: stage.by for stage in stages().values()}}
