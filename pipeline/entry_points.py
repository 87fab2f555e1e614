"""What the settings of runs and sweeps may name; nothing is imported."""

from __future__ import annotations

ROLES = {
    "mode": (
        "pipeline.modes.Cast",
        "pipeline.modes.EstimateTrials",
        "pipeline.modes.Batch",
        "pipeline.modes.Diagnose",
        "pipeline.modes.Calibrate",
    ),
    "launcher": (
        "pipeline.sweep.launchers.serial",
        "pipeline.sweep.launchers.joblib",
        "pipeline.sweep.launchers.ray",
        "pipeline.sweep.launchers.slurm",
    ),
    "finish": ("pipeline.sweep.finish.finish", "pipeline.paper.finish.finish"),
}
