"""Write an empty dataset to fill in: tables with their columns, and dataset.yaml."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from stringcast.data import disk
from stringcast.data.artifacts import ARM, GRASP, POINTS
from stringcast.data.metadata import DATASET_FILE
from stringcast.data.schema import Table
from stringcast.data.store import write_atomically
from stringcast.data.table_files import with_trial
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import UserError

METADATA_TEMPLATE = """\
# A dataset: one string, several trials. All is in metres, seconds and radians, x to
# the right, y up, angles counter-clockwise from +x. Only `format` is required; remove
# what you do not know.
format: 1
name: {name}
string:
  length: 0.300            # grasp to tip [m]: measure it
  # mass: 0.012            # of the string [kg], if it was weighed
  # tip_mass: 0.002        # of what hangs at its tip [kg]
noise:
  point_sigma: 0.001       # standard deviation of a measured coordinate [m]; if this
                           # line is removed, it is estimated
{hand}# camera: {{fps: 200}}        # required with frames or videos, with width,
                           # height, px_per_m and origin_px
# initial: moving          # if the string moves already when trials begin
# trials:                  # by their names in the tables; optional
#   t03: {{role: held_out}}  # used only to measure the gain
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
    """Write the dataset and return the exit status 0."""
    parser = CommandParser("python -m pipeline template", description=__doc__)
    parser.add_argument("folder", type=Path, help="to be made")
    parser.add_argument(
        "--poses",
        action="store_true",
        help="with poses of the hand instead of angles of joints",
    )
    options = parser.parse_args(arguments)
    folder: Path = options.folder
    if folder.exists():
        raise UserError(folder, "it is there already", "Name another folder.")

    hand_table = GRASP if options.poses else ARM
    metadata = METADATA_TEMPLATE.format(
        name=folder.name,
        hand="" if options.poses else ARM_LINES,
        motion=describe_columns(hand_table),
        points=describe_columns(POINTS),
    )
    with write_atomically(folder) as part:
        disk.make_folder(part)
        for table in (hand_table, POINTS):
            columns = with_trial(table).columns
            required = [column.name for column in columns if not column.optional]
            line = ",".join(required) + "\n"
            disk.write(part / f"{table.name}.csv", line.encode())
        disk.write(part / DATASET_FILE, metadata.encode())

    files = f"{hand_table.name}.csv, {POINTS.name}.csv, {DATASET_FILE}"
    console = Terminal()
    console.print_line(f"{folder}: {files}. Fill them in.")
    console.print_line(f"Then: {program_name()} check {shlex.quote(str(folder))}")
    return 0


def describe_columns(table: Table) -> str:
    """Return a line with all columns of a table, their meanings and units."""
    descriptions = []
    for column in with_trial(table).columns:
        unit = f" [{column.unit}]" if column.unit else ""
        optional = ", optional" if column.optional else ""
        descriptions.append(f"{column.name} ({column.meaning}{unit}{optional})")
    return f"{table.name}.csv: {', '.join(descriptions)}."
