"""Errors of the clock offset: `python3 tasks.py study alignment`.

Writes results/offsets.parquet. Most rows are of points of the hand with a noise of 0.7
mm, some of films of the virtual lab.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from rich.progress import track

from stringcast.data.artifacts import MASKS, POINTS, READINGS, Motion, Observation
from stringcast.data.schema import Table, parse_columns
from stringcast.data.store import write_table
from stringcast.hardware.virtual.bench import (
    Specimen,
    VirtualArm,
    VirtualBench,
    VirtualCamera,
)
from stringcast.pipeline.run.provenance import software_versions
from stringcast.stages.align.align import align, measured_table
from stringcast.stages.align.excitation.excite import excite
from stringcast.stages.align.fit import (
    AlignmentProblem,
    measurement_model,
    select_effects,
)
from stringcast.stages.align.grasp import grasp_sightings
from stringcast.stages.align.lookalike import OFFSET
from stringcast.stages.execute.execute import execute
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from tests.alignment.stand import AlignmentBench
from tests.conftest import configured

ROOT = Path(__file__).resolve().parents[3]
FOLDER = Path(__file__).with_name("results")
RATES = (200.0, 60.0, 30.0)
SIGMA = 7e-4  # [m]
# correlation, readout [s]
NOISES = {"white": (0.0, 0.0), "correlated": (0.9, 0.0), "rolling shutter": (0.0, 5e-3)}
OFFSETS = Table(
    "offsets",
    "a row for each alignment: what was hidden and what was found",
    parse_columns("""
    seen (text): points of the hand, or frames of the virtual lab
    noise (text): white; correlated from frame to frame by 0.9; or white behind a
        rolling shutter
    fps [1/s]: frames per second
    seed [1] (int): of motion, misalignment and noise
    hidden [s]: arm's clock less the camera's
    found [s]: what was found
    low [s]: lower end of the 95 % interval
    high [s]: upper end of the 95 % interval
    plain [s]: half width of the interval if nothing is there that was looked for and
        not seen
    effects (text): beyond those always measured, joined by ' + '
    """),
)


def main(arguments: Sequence[str]) -> None:
    """Draw and align datasets, store the errors, and print a summary."""
    parser = argparse.ArgumentParser(
        "python3 tasks.py study alignment", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument(
        "--filmed",
        type=int,
        default=3,
        help="alignments of filmed motions, at 30, 60 and 200 in turn",
    )
    asked = parser.parse_args(arguments)
    made = {
        "command": f"python -m tests.alignment --seeds {asked.seeds} --filmed {asked.filmed}"
    }
    made |= software_versions()
    asks = [
        partial(pointed, noise, fps, seed)
        for seed in range(asked.seeds)
        for noise in NOISES
        for fps in RATES
    ]
    asks += [
        partial(filmed, RATES[-1 - number % len(RATES)], 100 + number)
        for number in range(asked.filmed)
    ]
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, object]] = []
    for ask in track(asks, "alignments"):
        rows.append(ask())
        # finished rows are kept if the command is interrupted
        write_table(OFFSETS, pd.DataFrame(rows), FOLDER / "offsets.parquet", made)
    print(summary(pd.DataFrame(rows)).to_string(index=False))


def laid(fps: float) -> Model:
    """Return arm, camera and string of the default settings."""
    camera = replace(configured(Camera, "camera/highspeed.yaml"), fps=fps)
    return Model(String(0.3), configured(Arm, "arm/paper.yaml"), camera)


@cache
def draw_motion(seed: int) -> Motion:
    """Draw a motion."""
    block = yaml.safe_load((ROOT / "conf/excite/sines.yaml").read_text())
    given = {name: value for name, value in block.items() if name != "_target_"}
    return excite(laid(RATES[0]), (), seed=seed, **given)


def draw_misalignment(seed: int) -> dict[str, float]:
    """Draw a misalignment."""
    rng = np.random.default_rng([seed, 7])
    sizes = {OFFSET: 0.02, "camera_rotation.angle": 0.03, "pixel_scale.excess": 0.02}
    sizes |= {"camera_offset.x": 0.015, "camera_offset.y": 0.015}
    return {name: float(rng.uniform(-size, size)) for name, size in sizes.items()}


def pointed(noise: str, fps: float, seed: int) -> dict[str, object]:
    """Align by observed points."""
    correlation, readout = NOISES[noise]
    bench, true = (
        AlignmentBench(laid(fps), draw_motion(seed), seed),
        draw_misalignment(seed),
    )
    seen = bench.observation(
        true | {"rolling_shutter.readout": readout}, fps, SIGMA, correlation
    )
    problem = AlignmentProblem(
        measurement_model(bench.model), (grasp_sightings(seen, bench.model.arm),)
    )
    fit = select_effects(problem)
    measured = measured_table(problem, fit, 0.0)
    return row(
        "points",
        noise,
        fps,
        seed,
        true[OFFSET],
        measured,
        float(fit.half_widths[fit.names.index(OFFSET)]),
    )


def filmed(fps: float, seed: int) -> dict[str, object]:
    """Align by frames with a string in the hand."""
    true = draw_misalignment(seed)
    hidden: dict[str, dict[str, float]] = {}
    for name in sorted(true):
        effect, _, parameter = name.partition(".")
        hidden.setdefault(effect, {})[parameter] = true[name]
    model = laid(fps)
    bench = VirtualBench(
        model.arm,
        model.camera,
        replace(configured(Specimen, "specimen/A.yaml"), hidden=hidden),
        seed,
        trial_number=1,
    )
    trial = execute(
        draw_motion(seed),
        VirtualArm(bench),
        VirtualCamera(bench),
        before=0.2,
        after=0.2,
    )
    nothing = Observation(
        "t01", POINTS.empty(), READINGS.empty(), MASKS.empty(), arm=trial.arm
    )
    made = align(model, [nothing], {"t01": trial.film}, arm_width=0.035)
    return row("frames", "sensor", fps, seed, true[OFFSET], made.measured, np.nan)


def row(
    seen: str,
    noise: str,
    fps: float,
    seed: int,
    hidden: float,
    measured: pd.DataFrame,
    plain: float,
) -> dict[str, object]:
    """Return a row of OFFSETS."""
    found = measured.set_index("name").loc[OFFSET]
    effects = sorted({n.split(".")[0] for n in measured[measured["found"]]["name"]})
    beyond = [
        e
        for e in effects
        if e in ("arm_lag", "clock_drift", "rolling_shutter", "lens_distortion")
    ]
    where = {
        "seen": seen,
        "noise": noise,
        "fps": fps,
        "seed": seed,
        "hidden": hidden,
        "plain": plain,
    }
    ends = {"found": found["value"], "low": found["low"], "high": found["high"]}
    return where | ends | {"effects": " + ".join(beyond)}


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise errors [ms] and how often the intervals hold, for each kind."""
    error = (table["found"] - table["hidden"]) * 1e3
    told = table.assign(
        error=error.abs(),
        inside=(table["low"] <= table["hidden"]) & (table["hidden"] <= table["high"]),
        inside_plain=error.abs() <= table["plain"] * 1e3,
        half=(table["high"] - table["low"]) / 2 * 1e3,
        half_plain=table["plain"] * 1e3,
    )
    groups = told.groupby(["seen", "noise", "fps"])
    parts = {
        "runs": groups.size(),
        "rms_ms": groups["error"].agg(lambda e: np.sqrt(np.mean(e**2))),
        "worst_ms": groups["error"].max(),
        "half_ms": groups["half"].median(),
        "inside": groups["inside"].mean(),
        "half_plain_ms": groups["half_plain"].median(),
        "inside_plain": groups["inside_plain"].mean(),
    }
    return pd.DataFrame(parts).round(3).reset_index()
