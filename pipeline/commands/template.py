"""Write an empty dataset to be filled in: tables with their columns, and a dataset.yaml
that says what is what.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stringcast.data import disk
from stringcast.data.artifacts import ARM, GRASP, POINTS
from stringcast.data.dataset import with_trial
from stringcast.data.metadata import DATASET_FILE
from stringcast.data.schema import Table
from stringcast.data.store import write_atomically
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import UserError

METADATA_TEMPLATE = """\
# A dataset: one string, several trials. All is in metres, seconds and radians, x to the right, y up, angles
# counter-clockwise from +x. Only `format` must be there; take out what you do not know.
format: 1
name: {name}
string:
  length: 0.300            # grasp to tip [m]: measure it
  # mass: 0.012            # of the string [kg], if it was weighed
  # tip_mass: 0.002        # of what hangs at its tip [kg]
noise:
  point_sigma: 0.001       # of a measured coordinate, one sigma [m]; take it out, and it is estimated
{hand}# camera: {{fps: 200}}        # needed with frames or videos: width, height, px_per_m, origin_px
# initial: moving          # the string swings already when trials begin, as one that is let go does
# trials:                  # by the names that the tables have; nothing need be said of them
#   t03: {{role: held_out}}  # used to measure what is gained, and for nothing else
#   t04: {{invalid: "it slipped"}}
#
# {motion}
# {points}
"""
ARM_LINES = """\
arm:
  links: [0.25, 0.20, 0.135]   # lengths, base first [m]
  base: [0, 0]             # where joint 1 sits [m]
"""


def main(arguments: Sequence[str]) -> int:
    """Write an empty dataset to be filled in; the exit status."""
    parser = CommandParser("python -m pipeline template", description=__doc__)
    parser.add_argument("folder", type=Path, help="to be made")
    parser.add_argument(
        "--poses",
        action="store_true",
        help="with poses of the hand instead of angles of joints",
    )
    asked = parser.parse_args(arguments)
    if asked.folder.exists():
        raise UserError(f"{asked.folder}: it is there already. Name another folder.")
    hand = GRASP if asked.poses else ARM
    with write_atomically(asked.folder) as aside:
        disk.make_folder(aside)
        for table in (hand, POINTS):
            needed = [
                column.name
                for column in with_trial(table).columns
                if not column.optional
            ]
            disk.write(aside / f"{table.name}.csv", (",".join(needed) + "\n").encode())
        motion, points = (
            f"{table.name}.csv: {describe_columns(table)}." for table in (hand, POINTS)
        )
        lines = "" if hand is GRASP else ARM_LINES
        about = METADATA_TEMPLATE.format(
            name=asked.folder.name, hand=lines, motion=motion, points=points
        )
        disk.write(aside / DATASET_FILE, about.encode())
    console = Terminal()
    console.print(
        f"{asked.folder}: {hand.name}.csv, {POINTS.name}.csv, {DATASET_FILE}. Fill them in.",
        highlight=False,
        markup=False,
    )
    console.print(
        f"Then: {program_name()} check {asked.folder}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    return 0


def describe_columns(table: Table) -> str:
    """All columns of a table with unit and meaning, a line each."""
    said = (
        f"{column.name} ({column.meaning}{f' [{column.unit}]' if column.unit else ''}{', optional' * column.optional})"
        for column in with_trial(table).columns
    )
    return ", ".join(said)
