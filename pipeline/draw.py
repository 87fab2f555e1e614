"""`python -m pipeline draw <seed> <folder> <envelope>`: measured data of a virtual bench that hides a cause."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from rich.console import Console

from data.schema import DataError
from hardware.virtual.blind import draw
from pipeline.check import CONF
from pipeline.settings import build
from stages.model.arm import Arm
from stages.model.camera import Camera


def command(arguments: Sequence[str]) -> int:
    """Draw the bench of a seed; its data go into a folder, what it hides into a file elsewhere. The exit status."""
    asked = parser().parse_args(arguments)
    console = Console(stderr=True)
    try:
        with console.status("drawing a bench"):
            bench = draw(asked.seed, *bench_of_conf())
        bench.write(asked.folder)
        bench.envelope(asked.envelope)
    except DataError as error:
        console.print(f"[bold red]Error:[/] {error}", soft_wrap=True)
        return 1
    console.print(f"{asked.folder}: {len(bench.scene.casts)} trials. What they hide is in {asked.envelope}.")
    return 0


def parser() -> argparse.ArgumentParser:
    """Of the command's arguments."""
    made = argparse.ArgumentParser("python -m pipeline draw", description=__doc__, allow_abbrev=False)
    made.add_argument("seed", type=natural, help="from which string, casts and cause are drawn")
    made.add_argument("folder", type=Path, help="for the measured data")
    made.add_argument("envelope", type=Path, help="file for what is really so; keep it out of the folder")
    return made


def natural(text: str) -> int:
    """A whole number from 0."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def bench_of_conf() -> tuple[Arm, Camera]:
    """Arm and camera as configured."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        blocks: Any = OmegaConf.to_container(compose("config"))
    return build(Arm, blocks["arm"], "arm", "conf/arm"), build(Camera, blocks["camera"], "camera", "conf/camera")
