"""Draw a virtual bench that hides a cause: its measured data, and apart from them what is really so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stringcast.hardware.virtual.blind import draw
from stringcast.pipeline.commands import Arguments
from stringcast.pipeline.settings import build, composed
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera


def main(arguments: Sequence[str]) -> int:
    """Draw the bench of a seed; its data go into a folder, what it hides into a file elsewhere. The exit status."""
    parser = Arguments("python -m pipeline draw", description=__doc__, allow_abbrev=False)
    parser.add_argument("seed", type=natural, help="from which string, casts and cause are drawn")
    parser.add_argument("folder", type=Path, help="for the measured data")
    parser.add_argument("envelope", type=Path, help="file for what is really so; keep it out of the folder")
    asked = parser.parse_args(arguments)
    console = Terminal(stderr=True)
    with console.status("drawing a bench"):
        blocks = composed()
        arm, camera = (
            build(Arm, blocks["arm"], "arm", "conf/arm"),
            build(Camera, blocks["camera"], "camera", "conf/camera"),
        )
        bench = draw(asked.seed, arm, camera)
    bench.write(asked.folder)
    bench.envelope(asked.envelope)
    console.print(
        f"{asked.folder}: {len(bench.scene.casts)} trials. What they hide is in {asked.envelope}.",
        markup=False,
        soft_wrap=True,
    )
    return 0


def natural(text: str) -> int:
    """The whole number from 0 that a text says; raises ValueError for any other."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)
