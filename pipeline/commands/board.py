"""Draw the board of a calibration as a PDF, to be printed in its true size."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from stringcast.pipeline.commands import Arguments
from stringcast.pipeline.settings import build, composed
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.calibrate.board import Board
from stringcast.stages.calibrate.sheet import sheet


def main(arguments: Sequence[str]) -> int:
    """Draw the board as configured; the exit status."""
    asked = parser().parse_args(arguments)
    board = build(Board, composed(asked.settings)["board"], "board", "conf/board")
    asked.file.parent.mkdir(parents=True, exist_ok=True)
    asked.file.write_bytes(sheet(board))
    width, height = board.size * 1e3
    Terminal(stderr=True).print(
        f"{asked.file}: {width:.1f} x {height:.1f} mm. Print it at 100 %, glue it on something flat, measure ten "
        f"squares and give a tenth of that in metres as board.square if it is not {board.square:g}.",
        soft_wrap=True,
    )
    return 0


def parser() -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    made = Arguments("python -m pipeline board", description=__doc__, allow_abbrev=False)
    made.add_argument("file", type=Path, help="PDF to write")
    made.add_argument("settings", nargs="*", help="as for a run, such as board=a1 or board.square=0.03")
    return made
