"""Reading of real footage: `python3 tasks.py study footage FOLDER TABLE`.

FOLDER holds l4dc_strip_video (films of strips with the points their authors tracked)
and tudelft_cable_fr3/frames (photographs of a black cable before a white arm). TABLE is
the Parquet file that is written.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data import store
from stringcast.data.artifacts import Points
from stringcast.data.images import ImageFiles, Video
from stringcast.data.schema import Table, parse_columns
from stringcast.pipeline.run.provenance import step_origin
from stringcast.stages.common import rms
from stringcast.stages.extract.extract import extract
from stringcast.stages.extract.footage import Footage
from stringcast.stages.model.camera import Camera
from tests.benchmarks.extraction.scores import refusal_reasons

PX_PER_M = 2350.0  # scale of the strips' camera, as assumed by their authors
EVERY = 4  # frames
SETTINGS: Mapping[str, Any] = {
    "points": 31,
    "sigmas": 6.0,
    "arm_width": 0.0,
    "hidden": 0.006,
}
# 3 to 5 mm are hidden in the clamp
STRIP: Mapping[str, Any] = {"shorter": 0.15, "longer": 0.15}
CABLE: Mapping[str, Any] = {"shorter": 0.08, "longer": 0.1}
MEASURED = Table(
    "measured",
    "a row a film or photograph",
    parse_columns("""
    name (text): of the film or photograph
    frames [1] (int): how many were looked at
    read [1]: share that was accepted
    rms_mm [mm]: RMS distance from the published points; NaN where there are none
    median_mm [mm]: median distance
    worst_mm [mm]: of a frame, RMS over its points
    tip_rms_mm [mm]: RMS distance of the tips
    tip_sigma_mm [mm]: median sigma stated for the tip
    reasons (text): of refusals, the most frequent first
    """),
)


def strip(
    folder: Path, name: str, every: int = EVERY
) -> tuple[Footage, Camera, pd.DataFrame]:
    """Read every so many frames of a film, its camera and the published points.

    `name` is a name such as 75mm_2.
    """
    table = pd.read_parquet(folder / "points.parquet").query("trial == @name")
    film, t = Video(folder / "videos" / f"{name}.mp4"), np.sort(table["t"].unique())
    images = [film[i] for i in range(len(t))]
    origin_px = (
        float((table["u"] - PX_PER_M * table["x"]).mean()),
        float((table["v"] + PX_PER_M * table["y"]).mean()),
    )
    camera = Camera(640, 360, PX_PER_M, origin_px, 239.76)
    chosen = np.arange(0, len(t), every)
    return (
        Footage(
            t[chosen],
            [images[i] for i in chosen],
            np.tile([0, 0, -np.pi / 2], (len(chosen), 1)),
        ),
        camera,
        table,
    )


def strip_row(folder: Path, name: str) -> dict[str, object]:
    """Return the row of a film of a strip.

    It compares the points that are read with those that the authors tracked.
    """
    footage, camera, table = strip(folder, name)
    length = int(name.partition("mm")[0]) / 1e3
    found = extract(footage, camera, string_length=length, **SETTINGS, **STRIP)
    # distances from the published points, at their arc lengths [mm]
    frames, tips = [], []
    for t, rows in found.points.groupby("t"):
        real = table[np.abs(table["t"] - t) < 1e-6].sort_values("s")
        x, y = (np.interp(real["s"], rows["s"], rows[c]) for c in ("x", "y"))
        frames.append(1e3 * np.hypot(x - real["x"], y - real["y"]).to_numpy())
        tips.append(frames[-1][-1])
    each = [rms(some) for some in frames]
    off = {
        "rms_mm": rms(np.array(each)),
        "median_mm": float(np.median(np.concatenate(frames))),
    }
    return {
        "name": name,
        **_read(found),
        **off,
        "worst_mm": max(each),
        "tip_rms_mm": rms(np.array(tips)),
    }


def _read(found: Points) -> dict[str, object]:
    valid = found.readings["valid"]
    sigma = float(found.readings["tip_sigma"].median()) * 1e3
    return {
        "frames": len(valid),
        "read": valid.mean(),
        "tip_sigma_mm": sigma,
        "reasons": refusal_reasons(found.readings),
    }


def photograph_row(folder: Path, name: str, length: float) -> dict[str, object]:
    """Return the row of a single photograph of a dark cable before a bright arm."""
    known = {
        one["name"]: one
        for one in json.loads((folder / "frames.json").read_text(encoding="utf-8"))
    }[name]
    hand = np.array(known["P"]) @ np.array(known["O_T_EE"])[:, 3]
    scale = known["K_cam"][0][0] / hand[2]
    camera = Camera(1920, 1080, scale, tuple(hand[:2] / hand[2]), 30.0)
    footage = Footage(
        np.zeros(1),
        ImageFiles(folder, (known["file"],)),
        np.array([[0, 0, -np.pi / 2]]),
    )
    found = extract(footage, camera, string_length=length, **SETTINGS, **CABLE)
    return {"name": name, **_read(found)}


def main(arguments: Sequence[str]) -> None:
    """Read every film and photograph and write the table."""
    parser = argparse.ArgumentParser(
        "python3 tasks.py study footage", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("table", type=Path)
    asked = parser.parse_args(arguments)
    folder = asked.folder
    strips = folder / "l4dc_strip_video"
    photographs = folder / "tudelft_cable_fr3" / "frames"
    rows = [
        strip_row(strips, film.stem)
        for film in sorted((strips / "videos").glob("*.mp4"))
    ]
    rows += [
        photograph_row(photographs, name, length)
        for name, length in (("calib_1408", 0.6), ("calib_2908", 0.4))
    ]
    frame = MEASURED.check(
        pd.DataFrame(rows, columns=[c.name for c in MEASURED.columns])
    )
    store.write_table(MEASURED, frame, asked.table, step_origin({}, "measured", 0, {}))
    print(frame.round(2).to_string())
