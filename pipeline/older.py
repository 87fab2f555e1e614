"""Settings of runs that older versions made, as they would be written now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

TOGETHER = {"_target_": "pipeline.modes.Batch", "stage": "align", "read": False, "again": False}
DIAGNOSE = {"_target_": "pipeline.modes.Diagnose", "stage": "diagnose", "read": True, "first": []}
MODES: Mapping[tuple[str, ...], Mapping[str, Any]] = {  # what `steps` was, before there was a mode
    **{
        steps: {"_target_": "pipeline.modes.Cast", "stages": [*steps]}
        for steps in (("generate", "execute", "extract"), ("generate", "execute", "extract", "estimate"))
    },
    ("estimate",): {"_target_": "pipeline.modes.Estimate", "again": False},
    ("extract", "estimate"): {"_target_": "pipeline.modes.Estimate", "again": True},
    ("diagnose",): DIAGNOSE | {"again": False, "motions": 0},
    ("extract", "diagnose"): DIAGNOSE | {"again": True, "motions": 0},
    ("diagnose", "execute", "extract", "diagnose"): DIAGNOSE | {"again": False, "motions": 2},
    ("align",): TOGETHER | {"first": ["excite", "execute"]},
    ("calibrate",): {"_target_": "pipeline.modes.Calibrate"},
    ("study",): {"_target_": "pipeline.studies.blind.study.BlindStudy"},
    ("extraction_study",): {"_target_": "pipeline.studies.extraction.study.ExtractionStudy"},
    ("hit_study",): {"_target_": "pipeline.studies.hitting.study.HitStudy"},
    ("measured_study",): {"_target_": "pipeline.studies.measured.study.MeasuredStudy"},
}


# What decides in diagnoses of which this was no setting yet: they are made again by the rules of today.
CRITERIA = {
    "causes": 3,
    "coverage": 0.95,
    "alpha": 0.01,
    "tolerance": 2e-3,
    "least_size": 5e-4,
    "least_share": 0.5,
    "explained": 0.9,
}
FLOAT64 = {"_target_": "stages.model.precision.Double"}  # which is all there is now
RENAMED: Mapping[str, Mapping[str, str]] = {  # by the block that the settings are in; elsewhere as in ""
    "": {"memory": "trials_used", "leave": "keep"},
    "estimate": {"together": "batch"},
    "generate": {
        "together": "batch",
        "tries": "searches",
        "informative": "exploration",
        "fresh": "validation",
        "doubt": "uncertainty",
    },
}
MOVED = {  # what settings of stored runs still call by an old name
    "pipeline.paper.finish.finish": "pipeline.studies.paper.finish.finish",
    "stages.align.align": "stages.align.align.align",
    "stages.calibrate.calibrate": "stages.calibrate.calibrate.calibrate",
    "stages.diagnose.single_effects.diagnose.diagnose": "stages.diagnose.diagnose.diagnose",
    "stages.excite.excite": "stages.align.excitation.excite.excite",
    "stages.execute.execute": "stages.execute.execute.execute",
    "stages.extract.extract": "stages.extract.extract.extract",
    "stages.generate.generate": "stages.generate.generate.generate",
    "stages.rehearse.dry": "stages.execute.dry_run.dry",
    "stages.rehearse.slow": "stages.execute.dry_run.slow",
}


def new_name(name: str) -> str:
    """The full name of a setting today, `generate.validation` for `generate.fresh`."""
    block, dot, last = name.rpartition(".")
    return f"{block}{dot}{RENAMED.get(block, {}).get(last, last)}"


def modern(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a run by their names of today: `mode` instead of `steps`, nothing of float64, `diagnose.criteria`."""
    now, steps, string = _renamed(settings, ""), settings.get("steps"), settings.get("string")
    if isinstance(settings.get("diagnose"), Mapping):
        now["diagnose"] = now["diagnose"] | {"criteria": CRITERIA | now["diagnose"].get("criteria", {})}
    if isinstance(string, Mapping) and string.get("precision") == FLOAT64:
        now["string"] = {name: value for name, value in string.items() if name != "precision"}
    mode = next((dict(mode) for names, mode in MODES.items() if [*names] == steps), None)
    if "mode" in settings or mode is None:
        return now
    if mode.get("motions"):
        mode["motions"] = settings["manipulations"]
    return {name: value for name, value in now.items() if name != "steps"} | {"mode": mode}


def _renamed(block: Mapping[str, Any], place: str) -> dict[str, Any]:
    """A block of settings with today's names, all the way down. place: its own name."""
    names = RENAMED.get(place, RENAMED[""])
    return {
        names.get(name, name): _renamed(value, name) if isinstance(value, Mapping) else value
        for name, value in block.items()
    }
