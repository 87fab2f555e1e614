"""The names that a setting `_target_` may hold, role by role.

Settings come from other people's folders too (`trials=`, `extended=`, `calibrated=`, `resume`, `index` ...), so a name
is looked up here before anything is imported. Names are those within the package `stringcast`. An arm, a camera or a
mode of your own needs its line here; what may fill a stage's role, the stage says itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from stringcast.pipeline.registry import stages

SOURCES = ("hardware.camera.Device", "hardware.camera.ImageFolder", "hardware.camera.VideoFile")
DRY_RUNS = ("stages.execute.dry_run.dry", "stages.execute.dry_run.slow")
VIRTUAL = ("hardware.virtual.open_lab", "hardware.serial.rehearsal.open_lab")  # nothing real moves by these
SHELL: Mapping[str, tuple[str, ...]] = {
    "mode": (
        "pipeline.modes.Cast",
        "pipeline.modes.Estimate",
        "pipeline.modes.Batch",
        "pipeline.modes.Diagnose",
        "pipeline.modes.Calibrate",
        "pipeline.studies.blind.study.BlindStudy",
        "pipeline.studies.extraction.study.ExtractionStudy",
        "pipeline.studies.hitting.study.HitStudy",
        "pipeline.studies.measured.study.MeasuredStudy",
    ),
    "hardware": (*VIRTUAL, "hardware.serial.lab.open_lab", "hardware.dynamixel.lab.open_lab"),
    "source": SOURCES,  # of pictures
    "plane": SOURCES,
    "integrator": (
        "stages.model.integrator.SemiImplicitEuler",
        "stages.model.integrator.ExplicitEuler",
        "stages.model.integrator.RungeKutta4",
        "stages.model.implicit.ImplicitLeapfrog",
    ),
    "launcher": (
        "pipeline.sweep.launchers.serial",
        "pipeline.sweep.launchers.joblib",
        "pipeline.sweep.launchers.ray",
        "pipeline.sweep.launchers.slurm",
    ),
    "finish": ("pipeline.sweep.finish.finish", "pipeline.studies.paper.finish.finish"),
}


@cache
def roles() -> dict[str, tuple[str, ...]]:
    """The allowed names for each role, by the name of the settings that choose it."""
    return {**SHELL, **{stage.name: stage.by for stage in stages().values()}}
