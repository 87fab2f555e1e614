"""Draw the board of a calibration as a PDF, to be printed in its true size."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.calibrate.board import Board

INCH_M = 0.0254  # [m]
MARGIN_M = 0.008  # [m] white, which the outer markers need, and most printers too
RULER_M = 0.1  # [m]
# pixels of a square: a multiple of a marker's cells and its border
PIXELS_PER_MARKER_CELLS = 7 * 4


def main(arguments: Sequence[str]) -> int:
    """Draw the board as configured; the exit status."""
    parser = CommandParser(
        "python -m pipeline board", description=__doc__, allow_abbrev=False
    )
    parser.add_argument("file", type=Path, help="PDF to write")
    parser.add_argument(
        "settings",
        nargs="*",
        help="as for a run, such as board=a1 or board.square=0.03",
    )
    asked = parser.parse_args(arguments)
    board = build_dataclass(
        Board, compose_settings(asked.settings)["board"], "board", "conf/board"
    )
    asked.file.parent.mkdir(parents=True, exist_ok=True)
    asked.file.write_bytes(board_page(board))
    width, height = board.size * 1e3
    Terminal(stderr=True).print(
        f"{asked.file}: {width:.1f} x {height:.1f} mm. Print it at 100 %, glue it on something flat, measure ten "
        f"squares and give a tenth of that in metres as board.square if it is not {board.square:g}.",
        soft_wrap=True,
    )
    return 0


def board_page(board: Board) -> bytes:
    """A PDF of one page: the pattern, and a ruler by which to see whether the printer
    scaled it.
    """
    width, height = (board.size + 2 * MARGIN_M) / INCH_M
    figure = Figure(figsize=(width, height + 2 * MARGIN_M / INCH_M))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(
        xlim=(-MARGIN_M, board.size[0] + MARGIN_M),
        ylim=(-3 * MARGIN_M, board.size[1] + MARGIN_M),
    )
    axes.axis("off")
    pixels = board.image(
        round(board.square / board.marker * PIXELS_PER_MARKER_CELLS * 4)
    )
    axes.imshow(
        pixels,
        cmap="gray",
        interpolation="none",
        extent=(0, board.size[0], 0, board.size[1]),
    )
    axes.plot(
        [0, RULER_M], [-1.6 * MARGIN_M] * 2, color="black", lw=0.5, marker="|", ms=8
    )
    words = f"100 mm · squares {board.square * 1e3:g} mm, markers {board.marker * 1e3:g} mm, {board.dictionary}"
    axes.text(0, -2.5 * MARGIN_M, words, fontsize=7)
    page = io.BytesIO()
    figure.savefig(page, format="pdf", metadata={"CreationDate": None})
    return page.getvalue()
