"""A calibration as one command: pictures taken, the camera measured, camera.yaml and the page in the run's folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from stringcast.data import store
from stringcast.data.calibration import Calibration
from stringcast.hardware.camera import Source
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.inherited import CAMERA
from stringcast.pipeline.origin import PACKAGES, code, origin, versions
from stringcast.pipeline.settings import UserError, build, chosen
from stringcast.stages.calibrate import Board
from stringcast.stages.common import Progress
from stringcast.stages.report.calibration import CalibrationRecord, calibration_report

TILT = "Move the board slowly, tilted in all directions, all over the picture."
HOLD = "Hold the board still in the plane of motion."


@dataclass(frozen=True)
class Taken:
    """Pictures of a board: tilted in all directions, and held in the plane of motion."""

    board: Board
    tilted: list[np.ndarray]
    flat: list[np.ndarray]


def taken(here: Experiment, ask: Callable[[str], object]) -> Taken:
    """All pictures, of whatever source. ask: tells a person what to do for a live one, and waits."""
    board = build(Board, here.config["board"], "board", "conf/board")
    tilted, flat = (source(here, name) for name in ("source", "plane"))
    return Taken(
        board,
        list(tilted.stills(here.camera, lambda: ask(TILT))),
        list(flat.stills(here.camera, lambda: ask(HOLD))),
    )


def source(here: Experiment, name: str) -> Source:
    """One of the sources, as configured."""
    made: Source = chosen(here.config[name], name, f"conf/source, as {name}")
    return made


def run(here: Experiment, folder: Path, looked: Taken, progress: Progress) -> Calibration:
    """Measure, and leave the artifact, the page and, of a good one, camera.yaml."""
    pictures = (looked.tilted, looked.flat)
    made: Calibration = here.stages["calibrate"](*pictures, looked.board, here.camera, progress=progress)
    store.save(made, folder / "calibration", origin(here.config, "calibrate", here.seed, {}))
    made_by = {"seed": here.seed, "code": code(), "packages": versions(PACKAGES)}
    record = CalibrationRecord(here.config["name"], sentence(made), made, here.config, made_by)
    store.write_text(folder / "report.html", calibration_report(record))
    if not made.reason:
        store.write_text(folder / CAMERA, str(made.outcome["camera"].iloc[0]))
    return made


def refuse(made: Calibration, folder: Path) -> None:
    """Raise UserError for a calibration that cannot be used."""
    if made.reason:
        raise UserError(f"the calibration cannot be used: {made.reason} See {folder / 'report.html'}")


def sentence(made: Calibration) -> str:
    """How it ended."""
    outcome = made.outcome.iloc[0]
    if made.reason:
        return f"This calibration cannot be used: {made.reason}"
    return (
        f"The camera is known: reprojection error {outcome['rms']:.2f} px, {outcome['held_out_rms']:.2f} px on views "
        f"left out, {outcome['plane_rms']:.2f} px in the plane of motion."
    )


def summary(made: Calibration, folder: Path) -> Group:
    """What was measured, and how to go on."""
    table = Table(box=None, pad_edge=False)
    for heading in ("parameter", "value", "sigma", "unit", ""):
        table.add_column(heading)
    for row in made.measured.itertuples():
        table.add_row(row.name, f"{row.value:.6g}", f"{row.sigma:.2g}", row.unit, row.meaning)
    ahead = (f"Go on with it: calibrated={folder}", str(folder / "report.html"))
    return Group(Text(sentence(made)), table, *(Text(line, overflow="fold") for line in ahead))
