"""Write the string of a run for other programs: a MuJoCo chain or a parameter table."""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from stringcast.data.errors import escape_control_characters
from stringcast.data.store import write_text
from stringcast.known import KnownString, experiment_for_call
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import UserError

RUN_HELP = "folder of a diagnosis, an estimation or casts; or an extended.yaml"
FILE_HELP = (
    "by its ending, .xml: a chain of links as MJCF (MuJoCo, Playground, Isaac); "
    ".csv: parameters with units"
)
MASS_HELP = "of the string [kg], which its motion does not show; for .xml"
DEFAULT_STEP_S = 5e-4
MAX_MASS_KG, MAX_STEP_S = 100, 0.1


def main(arguments: list[str]) -> int:
    """Write the file and return the exit status 0."""
    parser = CommandParser("python -m pipeline export", description=__doc__)
    parser.add_argument("run", type=Path, help=RUN_HELP)
    parser.add_argument("file", type=Path, help=FILE_HELP)
    parser.add_argument("--mass", type=float, help=MASS_HELP)
    parser.add_argument(
        "--step",
        type=float,
        default=DEFAULT_STEP_S,
        help="of the simulation [s]; for .xml",
    )
    options = parser.parse_args(arguments)
    string = KnownString.from_run(options.run)
    file: Path = options.file
    if file.suffix == ".xml":
        text = mjcf_text(string, options)
    elif file.suffix == ".csv":
        text = parameter_table(string)
    else:
        remedy = "Give it .xml for MuJoCo, or .csv for a table of parameters."
        raise UserError(f"{file}: its ending names no format. {remedy}")

    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, text)
    print(escape_control_characters(str(file)))
    return 0


def mjcf_text(string: KnownString, options: argparse.Namespace) -> str:
    """Return the string as MJCF; raise UserError unless mass and step are sensible."""
    mass, step = options.mass, options.step
    if mass is None or not 0 < mass < MAX_MASS_KG or not 0 < step < MAX_STEP_S:
        given = f"--mass {mass}"
        if step != DEFAULT_STEP_S:
            given += f" --step {step}"
        raise UserError(
            f"{given}: the string's mass must be given in kg, the step in s. "
            "Weigh it, and give --mass 0.012."
        )
    return string.mjcf(mass, step)


def parameter_table(string: KnownString) -> str:
    """Return CSV with a row for each parameter and its 95 % interval where known.

    The paper's parameters are per mass point, at `string.reference_points` points.
    """
    model = experiment_for_call((), string).model
    rows = []
    for parameter in model.parameters:
        low, high = model.measured_ranges.get(parameter.name, (None, None))
        row = {
            "name": parameter.name,
            "symbol": parameter.symbol,
            "value": parameter.start,
            "low": low,
            "high": high,
            "unit": parameter.unit,
            "meaning": parameter.meaning,
        }
        rows.append(row)
    table: str = pd.DataFrame(rows).to_csv(index=False)
    return table
