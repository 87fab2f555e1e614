"""Public measurements of others as datasets: cables held by a robot, and strips of silicone.

Both folders hold many strings side by side, each of which is a dataset of its own. What their tables do not say is said
here: lengths (the outermost marker is the tip), which trials begin moving, and a marker's noise.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas as pd
import yaml

CABLES, STRIPS = "tudelft_cable_fr3", "l4dc_strip_video"
CABLE = re.compile(r"(?P<begun>drive|release|slow)_(?P<name>.*)")
STRIP = re.compile(r"(?P<name>\d+mm)_\d+")
MARKER = 0.003  # [m] one standard deviation, as the cables' authors say it
RELEASED = "release_"


def sets(folder: Path) -> dict[str, list[str]]:
    """Names of the trials of each string, by the string's name: cables, loops of cable, strips."""
    found: dict[str, list[str]] = {}
    for source, named in ((CABLES, CABLE), (STRIPS, STRIP)):
        for trial in sorted(pd.read_parquet(folder / source / "points.parquet", columns=["trial"])["trial"].unique()):
            if match := named.fullmatch(trial):
                found.setdefault(match["name"], []).append(trial)
    return found


def written(folder: Path, name: str, trials: list[str], to: Path) -> Path:
    """The dataset of one string. Returns its folder."""
    source = folder / (STRIPS if STRIP.fullmatch(trials[0]) else CABLES)
    to.mkdir(parents=True, exist_ok=True)
    for table in ("grasp", "points"):
        rows = pd.read_parquet(source / f"{table}.parquet")
        rows = rows[rows["trial"].isin(trials)]
        if "held" in rows:
            rows = rows.assign(valid=~rows["held"])
        rows.to_parquet(to / f"{table}.parquet", index=False)
    length = float(pd.read_parquet(to / "points.parquet")["s"].max())
    about = {"format": 1, "name": name, "string": {"length": round(length, 4)} | weighed(source, name)}
    about |= {"noise": {"point_sigma": MARKER}} if source.name == CABLES else {}
    about["trials"] = {trial: {"initial": begins(trial)} for trial in trials}
    (to / "dataset.yaml").write_text(yaml.safe_dump(about, sort_keys=False))
    return to


def weighed(source: Path, name: str) -> dict[str, float]:
    """What the authors weighed of a cable [kg]."""
    known = json.loads((source / "cables.json").read_text()) if source.name == CABLES else {}
    return {"mass": known[name]["m_cable_kg"], "tip_mass": known[name]["m_tip_kg"]} if name in known else {}


def begins(trial: str) -> str:
    """Cables that the robot drives, or moves slowly, hang at rest at first; all else is let go."""
    match = CABLE.fullmatch(trial)
    return "rest" if match and match["begun"] != "release" else "moving"
