"""How near a model comes to cables that others measured: `python -m tests.measured.fits ../shared/measured`.

Fits each released cable with a stated set of laws by least squares, as a person would do it by hand, and leaves fits.parquet
in data/results/measured: a row for each cable and set. About a minute of a core each; a fit that is in --out is kept.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
from rich.progress import track

from stringcast.data.schema import Column, Table
from stringcast.data.store import origin_of, write_table, write_text
from stringcast.pipeline.origin import PACKAGES, versions
from tests.measured.answers import AUTHORS
from tests.measured.sets import RELEASED, sets, written

ROOT = Path(__file__).resolve().parents[2]
LAWS = {
    "viscous": "rest_curvature",
    "one slip": "rest_curvature,maxwell_slip",
    "two slips": "rest_curvature,maxwell_slip,maxwell_slip_2",
}
FITS = Table(
    "fits",
    "a row for each released cable and set of laws, fitted to this one trial",
    (
        Column("string", "", "its name", "text"),
        Column("laws", "", "beside the paper's own, and the tip mass that was weighed", "text"),
        Column("fitted", "1", "parameters that were fitted", "int"),
        Column("rms", "m", "of both markers, in sample"),
        Column("tip", "m", "of the marker at the tip, in sample"),
        Column("tip_authors", "m", "the same of the model of those who measured it"),
        Column("seconds", "s", "of the whole command on one core, which other work may have used too"),
        Column("code", "", "commit that fitted it", "text"),
    ),
)


def fitted(dataset: Path, effects: str, folder: Path) -> float:
    """Fit a dataset by the command that a person gives, on one thread, and keep its run in a folder; its time [s]."""
    if not (folder / "seconds").exists():
        call = ["+experiment=estimate", "estimate=least_squares", f"trials={dataset}", "string=cable"]
        call += [f"effects=[{effects}]", "leave=[]", f"hydra.run.dir={folder}"]
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-m", "pipeline", *call], cwd=ROOT, check=True)
        write_text(folder / "seconds", f"{time.perf_counter() - begun:.0f}")
    return float((folder / "seconds").read_text())


def row(name: str, laws: str, dataset: Path, folder: Path) -> dict[str, object]:
    """A row of the table."""
    seconds = fitted(dataset, LAWS[laws], folder)
    said = json.loads((folder / "run.json").read_text())["iterations"][0]
    made = folder / "iterations" / "01" / "estimate"
    count = len(pd.read_parquet(made / "parameters.parquet")) - 1  # the tip mass was weighed
    found = {"string": name, "laws": laws, "fitted": count, "rms": said["rms_m"], "tip": said["tip_rms_m"]}
    code = origin_of(made / "fit.parquet")["code"]["commit"][:7]
    return found | {"tip_authors": AUTHORS[name], "seconds": seconds, "code": code}


def main() -> None:
    """Fit what is not fitted, and write the table."""
    parser = argparse.ArgumentParser("python -m tests.measured.fits", description=__doc__)
    parser.add_argument("measured", type=Path, help="folder with both sets, as ../shared/measured")
    parser.add_argument("--out", type=Path, default=ROOT / "outputs" / "fits", help="datasets and runs")
    asked = parser.parse_args()
    if not asked.measured.is_dir():
        sys.exit(f"{asked.measured}: there is no such folder. Name the one that holds both sets.")
    there, rows = sets(asked.measured), []
    for name in track(AUTHORS, "cables"):
        released = [trial for trial in there[name] if trial.startswith(RELEASED)]
        dataset = written(asked.measured, name, released, asked.out / name)
        rows += [row(name, laws, dataset, asked.out / f"{name}-{laws.replace(' ', '-')}") for laws in LAWS]
    made = {"command": "python -m tests.measured.fits ../shared/measured", "packages": versions(PACKAGES)}
    table = ROOT / "data" / "results" / "measured" / "fits.parquet"
    write_table(FITS, pd.DataFrame(rows), table, made)
    print(pd.DataFrame(rows).round(4).to_string(index=False))


if __name__ == "__main__":
    main()
