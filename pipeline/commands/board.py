"""Draw the board of a calibration as a PDF, to be printed in its true size."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from stringcast.pipeline.commands import Arguments
from stringcast.pipeline.settings import build, composed
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.calibrate.board import Board

INCH = 0.0254  # [m]
MARGIN = 0.008  # [m] white, which the outer markers need, and most printers too
RULER = 0.1  # [m]
CELLS = 7 * 4  # pixels of a square: a multiple of a marker's cells and its border


def main(arguments: Sequence[str]) -> int:
    """Draw the board as configured; the exit status."""
    parser = Arguments("python -m pipeline board", description=__doc__, allow_abbrev=False)
    parser.add_argument("file", type=Path, help="PDF to write")
    parser.add_argument("settings", nargs="*", help="as for a run, such as board=a1 or board.square=0.03")
    asked = parser.parse_args(arguments)
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


def sheet(board: Board) -> bytes:
    """A PDF of one page: the pattern, and a ruler by which to see whether the printer scaled it."""
    width, height = (board.size + 2 * MARGIN) / INCH
    figure = Figure(figsize=(width, height + 2 * MARGIN / INCH))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-MARGIN, board.size[0] + MARGIN), ylim=(-3 * MARGIN, board.size[1] + MARGIN))
    axes.axis("off")
    pixels = board.drawn(round(board.square / board.marker * CELLS * 4))
    axes.imshow(pixels, cmap="gray", interpolation="none", extent=(0, board.size[0], 0, board.size[1]))
    axes.plot([0, RULER], [-1.6 * MARGIN] * 2, color="black", lw=0.5, marker="|", ms=8)
    words = f"100 mm · squares {board.square * 1e3:g} mm, markers {board.marker * 1e3:g} mm, {board.dictionary}"
    axes.text(0, -2.5 * MARGIN, words, fontsize=7)
    page = io.BytesIO()
    figure.savefig(page, format="pdf", metadata={"CreationDate": None})
    return page.getvalue()
