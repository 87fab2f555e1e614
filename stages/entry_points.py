"""What the settings of the string may name; nothing is imported.

Each stage states itself which functions may fill its role (`by` of its description).
"""

from __future__ import annotations

DRY_RUNS = ("stages.execute.dry_run.dry_run", "stages.execute.dry_run.slow_run")
ROLES = {
    "integrator": (
        "stages.model.engine.integrators.SemiImplicitEuler",
        "stages.model.engine.integrators.RungeKutta4",
        "stages.model.engine.implicit_leapfrog.ImplicitLeapfrog",
    ),
}
