"""Write the string that a run found for other programs: a chain for MuJoCo, or a card
of its parameters.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

from stringcast.data.errors import escape_control_characters
from stringcast.data.store import write_text
from stringcast.known import KnownString, experiment_for_call
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import UserError

FILE_HELP = "by its ending, .xml: a chain of links as MJCF (MuJoCo, Playground, Isaac); .csv: parameters with units"


def main(arguments: list[str]) -> int:
    """Write the file; the exit status."""
    parser = CommandParser("python -m pipeline export", description=__doc__)
    parser.add_argument(
        "run",
        type=Path,
        help="folder of a diagnosis, an estimation or casts; or an extended.yaml",
    )
    parser.add_argument("file", type=Path, help=FILE_HELP)
    parser.add_argument(
        "--mass",
        type=float,
        help="of the string [kg], which its motion does not tell; for .xml",
    )
    parser.add_argument(
        "--step", type=float, default=5e-4, help="of the simulation [s]; for .xml"
    )
    asked = parser.parse_args(arguments)
    string, forms = (
        KnownString.from_run(asked.run),
        {".xml": mjcf_text, ".csv": parameter_card},
    )
    if asked.file.suffix not in forms:
        raise UserError(
            f"{asked.file}: its ending names no form. Give it .xml for MuJoCo, or .csv for a card."
        )
    text = forms[asked.file.suffix](string, asked)
    asked.file.parent.mkdir(parents=True, exist_ok=True)
    write_text(asked.file, text)
    print(escape_control_characters(str(asked.file)))
    return 0


def mjcf_text(string: KnownString, asked: argparse.Namespace) -> str:
    """The chain. Raises UserError where the mass is not given or no mass."""
    if asked.mass is None or not 0 < asked.mass < 100 or not 0 < asked.step < 0.1:
        given = (
            f"--mass {asked.mass}"
            if asked.step == 5e-4
            else f"--mass {asked.mass} --step {asked.step}"
        )
        raise UserError(
            f"{given}: the string's mass must be given in kg, the step in s. Weigh it: --mass 0.012, say."
        )
    return string.mjcf(asked.mass, asked.step)


def parameter_card(string: KnownString, asked: argparse.Namespace) -> str:
    """A row for each parameter, with its 95 % interval where that is known: the paper's
    per mass point at string.reference_points.
    """
    model = experiment_for_call((), string).model
    rows = [
        {"name": p.name, "symbol": p.symbol, "value": p.start, "low": low, "high": high}
        | {"unit": p.unit, "meaning": p.meaning}
        for p in model.parameters
        for low, high in [model.measured_ranges.get(p.name, (None, None))]
    ]
    return pd.DataFrame(rows).to_csv(index=False)
