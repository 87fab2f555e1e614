"""What a setting `_target_` may name, role by role.

Settings come from other people's folders too (`trials=`, `extended=`, `calibrated=`, `resume`, `index` ...), so a name
is looked up here before anything is imported. Names are those within the package `stringcast`. An arm, a camera or an
estimator of your own needs its line here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SOURCES = ("hardware.camera.Device", "hardware.camera.ImageFolder", "hardware.camera.VideoFile")
REHEARSALS = ("stages.execute.dry_run.dry", "stages.execute.dry_run.slow")
VIRTUAL = ("hardware.virtual.open_lab", "hardware.serial.rehearsal.open_lab")  # nothing real moves by these
ROLES: Mapping[str, tuple[str, ...]] = {
    "generate": ("stages.generate.generate", "stages.generate.robust.generate"),
    "excite": ("stages.align.excitation.excite.excite",),
    "execute": ("stages.execute.execute.execute", *REHEARSALS),
    "extract": ("stages.extract.extract",),
    "estimate": (
        "stages.estimate.random_search.estimate",
        "stages.estimate.cma_es.estimate",
        "stages.estimate.least_squares.estimate",
    ),
    "align": ("stages.align.align",),
    "diagnose": ("stages.diagnose.diagnose.diagnose",),
    "calibrate": ("stages.calibrate.calibrate",),
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
        "pipeline.sweep.launchers.serial.launch",
        "pipeline.sweep.launchers.joblib.launch",
        "pipeline.sweep.launchers.ray.launch",
        "pipeline.sweep.launchers.slurm.launch",
    ),
    "finish": ("pipeline.sweep.finish.finish", "pipeline.paper.finish.finish"),
}

MOVED = {  # what settings of stored runs still call by an old name
    "stages.excite.excite": "stages.align.excitation.excite.excite",
    "stages.execute.execute": "stages.execute.execute.execute",
    "stages.rehearse.dry": "stages.execute.dry_run.dry",
    "stages.rehearse.slow": "stages.execute.dry_run.slow",
}


def moves_a_real_arm(config: Mapping[str, Any]) -> bool:
    """Whether a run with these settings moves something that can break."""
    return "execute" in config["steps"] and config["hardware"].get("_target_") not in VIRTUAL
