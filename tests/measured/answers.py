"""What the diagnosis says of one string that others measured."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stringcast.data.artifacts import Diagnosis
from stringcast.data.store import write_text
from stringcast.pipeline.settings import composed
from stringcast.pipeline.study.command import diagnosis
from tests.measured.sets import RELEASED, written

# Root mean square of the tip in released trials, of the models of those who measured them, fitted to these [m]: arXiv
# 2402.16114, as ../shared/measured/README.md has it.
AUTHORS = {
    "black_short_unweighted": 0.017,
    "black_short_weighted": 0.016,
    "black_unweighted": 0.022,
    "black_weighted": 0.028,
    "orange_short_unweighted": 0.017,
    "orange_short_weighted": 0.030,
    "orange_weighted": 0.066,
}


def answer(measured: Path, name: str, trials: list[str], out: Path) -> dict[str, Any]:
    """A row of the table but for the code; the diagnosis is left in `out`."""
    dataset, begun = written(measured, name, trials, out / "dataset"), time.perf_counter()
    found = diagnosis(dataset, composed(["+experiment=diagnose"]))
    seconds = time.perf_counter() - begun
    text = found.finding["diagnosis"].iloc[0]
    write_text(out / "diagnosis.json", text)
    write_text(out / "extended.yaml", found.finding["extended"].iloc[0])
    authors = {"tip_authors": AUTHORS.get(name, float("nan"))}
    return {"string": name} | said(json.loads(text), found) | authors | {"seconds": seconds}


def said(document: dict[str, Any], found: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says, and how far its models are off."""
    causes = {cause["effect"]: cause["probability"] for cause in document["causes"]}
    chances = causes | {other["effect"]: other["probability"] for other in document["alternatives"]}
    known = yaml.safe_load(found.finding["extended"].iloc[0])["known"]
    rms = document["gain"]["rms_m"]
    tip = {side: _released_tip(found, side) for side in ("base", "extended")}
    return {
        "trials": len(document["trials"]["used"]),
        "verdict": document["verdict"],
        "named": ", ".join(f"{cause} {chance:.2f}" for cause, chance in causes.items()),
        "explained": " + ".join(sorted({name.split(".")[0] for name in known if "." in name})),
        "unknown": chances.get("unknown", 0.0),
        "rms_base": _number(rms["base"]),
        "rms_extended": _number(rms["extended"]),
        "noise": _number(rms["noise_floor"]),
        "tip_base": tip["base"],
        "tip_extended": tip["extended"],
    }


def _released_tip(found: Diagnosis, side: str) -> float:
    """Root mean square distance of the outermost point in released trials [m]; NaN where there are none."""
    rows = found.residuals
    rows = rows[rows["trial"].str.startswith(RELEASED) & (rows["s"] == rows["s"].max())]
    off = np.hypot(rows["x"] - rows[f"{side}_x"], rows["y"] - rows[f"{side}_y"])
    return float(np.sqrt(np.mean(off**2))) if len(rows) else float("nan")


def _number(said: float | None) -> float:
    """What a document does not say is NaN."""
    return float("nan") if said is None else said
