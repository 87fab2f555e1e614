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

INCH_M = 0.0254
MARGIN_M = 0.008  # white border for the outer markers and most printers
RULER_M = 0.1
# pixels of a marker: a multiple of its 7 cells with border
PIXELS_PER_MARKER = 7 * 4 * 4


def main(arguments: Sequence[str]) -> int:
    """Draw the configured board and return the exit status 0."""
    parser = CommandParser(
        "python -m pipeline board", description=__doc__, allow_abbrev=False
    )
    parser.add_argument("file", type=Path, help="PDF to write")
    parser.add_argument(
        "settings",
        nargs="*",
        help="as for a run, such as board=a1 or board.square=0.03",
    )
    options = parser.parse_args(arguments)
    settings = compose_settings(options.settings)["board"]
    board = build_dataclass(Board, settings, "board", "conf/board")

    options.file.parent.mkdir(parents=True, exist_ok=True)
    options.file.write_bytes(board_page(board))
    width, height = board.size * 1e3
    Terminal(stderr=True).print_line(
        f"{options.file}: {width:.1f} x {height:.1f} mm. Print it at 100 %, glue it on "
        "something flat, measure ten squares and give a tenth of that in metres as "
        f"board.square if it is not {board.square:g}."
    )
    return 0


def board_page(board: Board) -> bytes:
    """Return a PDF of one page: the pattern, and a ruler that shows the true scale."""
    width, height = board.size
    figure_width = (width + 2 * MARGIN_M) / INCH_M
    figure_height = (height + 2 * MARGIN_M) / INCH_M + 2 * MARGIN_M / INCH_M
    figure = Figure(figsize=(figure_width, figure_height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-MARGIN_M, width + MARGIN_M)
    axes.set_ylim(-3 * MARGIN_M, height + MARGIN_M)
    axes.axis("off")

    pixels = board.image(round(board.square / board.marker * PIXELS_PER_MARKER))
    extent = (0, width, 0, height)
    axes.imshow(pixels, cmap="gray", interpolation="none", extent=extent)
    ruler_y = [-1.6 * MARGIN_M] * 2
    axes.plot([0, RULER_M], ruler_y, color="black", lw=0.5, marker="|", ms=8)
    sizes = f"squares {board.square * 1e3:g} mm, markers {board.marker * 1e3:g} mm"
    caption = f"100 mm · {sizes}, {board.dictionary}"
    axes.text(0, -2.5 * MARGIN_M, caption, fontsize=7)

    page = io.BytesIO()
    figure.savefig(page, format="pdf", metadata={"CreationDate": None})
    return page.getvalue()
