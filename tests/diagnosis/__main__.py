"""How well experiments are foretold: `python -m tests.diagnosis`. Leaves decisions.parquet in data/results/deciding.

Two slow casts of string B, with one cause hidden that has look-alikes, are diagnosed; the motion proposed is performed
on the same bench, and all three casts are diagnosed together.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from rich.progress import track

from stringcast.data.artifacts import JOINTS, Diagnosis
from stringcast.data.schema import Column, Table
from stringcast.data.store import write_table
from stringcast.hardware.virtual.blind import LATEST, VERSIONS
from stringcast.hardware.virtual.blind.bench import BlindBench
from stringcast.hardware.virtual.blind.casts import Cast, performed, random_cast
from stringcast.hardware.virtual.blind.scene import Scene
from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.provenance import software
from stringcast.pipeline.studies.blind.study import diagnosis
from stringcast.stages.model.library import named

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "data" / "results" / "deciding"
SLOW = (0.6, 1.5)  # speeds of the hand [m/s]
SIGMA = 7e-4  # [m]
TINY = 1e-300  # chance of what nobody weighed
HIDDEN = {  # causes that have look-alikes
    "arm_lag": {"time_constant": 0.008},
    "time_offset": {"offset": -0.006},
    "tip_mass": {"ratio": 0.03},
    "rest_curvature": {"curvature": 0.6},
    "gravity_direction": {"tilt": 0.02},
    "grasp_angle": {"angle": 0.03},
}
DECISIONS = Table(
    "decisions",
    "a row for each bench: what was said of two casts, what a third was to say, and what it said",
    (
        Column("seed", "1", "of casts and noise", "int"),
        Column("hidden", "", "the cause", "text"),
        Column("before", "", "causes named from two casts, joined by ' + '", "text"),
        Column("right_before", "1", "probability of the sets that hold the cause"),
        Column("between", "", "what the motion proposed tells apart; empty if none was proposed", "text"),
        Column("expected", "1", "log odds expected of it"),
        Column("spread", "1", "their standard deviation, as foretold"),
        Column("probability", "1", "that it decides, as foretold"),
        Column("after", "", "causes named from all three, joined by ' + '", "text"),
        Column("right_after", "1", "probability of the sets that hold the cause"),
        Column("found", "1", "log odds of the likeliest set that holds the cause over the likeliest that does not"),
    ),
)


def main() -> None:
    """Draw, diagnose, perform, diagnose; keep what came out, and say it."""
    parser = argparse.ArgumentParser("python -m tests.diagnosis", description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="benches; the causes take turns")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    asked = parser.parse_args()
    made = {"command": f"python -m tests.diagnosis --seeds {asked.seeds} --first {asked.first}"}
    made |= software()
    asked.folder.mkdir(parents=True, exist_ok=True)
    here, rows = configured(), list[dict[str, object]]()
    for seed in track(range(asked.first, asked.first + asked.seeds), "benches"):
        rows.append(decided(seed, here))
        write_table(DECISIONS, pd.DataFrame(rows), asked.folder / "decisions.parquet", made)  # what is done stands
        print(rows[-1])


def decided(seed: int, here: Experiment) -> dict[str, object]:
    """A row of DECISIONS."""
    name = list(HIDDEN)[seed % len(HIDDEN)]
    rng = np.random.default_rng([seed, 41])
    scene = slow_scene(here, rng)
    points = observed(scene, name, rng)
    first = diagnosed(scene, points, here)
    row = {"seed": seed, "hidden": name} | said(first, name, "before")
    experiment = json.loads(first.finding["diagnosis"].iloc[0])["next_experiment"]
    if not len(first.commands):
        nothing = dict.fromkeys(("expected", "spread", "probability", "found"), np.nan)
        return row | nothing | {"between": "", "after": row["before"], "right_after": row["right_before"]}
    row |= {"between": ", ".join(experiment["between"]), "probability": experiment["probability_to_decide"]}
    row |= {"expected": experiment["expected_log_odds"], "spread": experiment["spread"]}
    third = scene.performing((proposed(first, scene, here, rng),))
    points = np.concatenate([points, observed(third, name, rng)])
    last = diagnosed(scene.performing((*scene.casts, *third.casts)), points, here)
    return row | said(last, name, "after") | {"found": odds(last, name)}


def configured() -> Experiment:
    """The default settings of a diagnosis."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        config = OmegaConf.to_container(compose("config", ["+experiment=blind_study"]), resolve=True)
    return prepare(config, lambda block: f"conf/{block}")


def slow_scene(here: Experiment, rng: np.random.Generator) -> Scene:
    """Two casts of string B."""
    base = yaml.safe_load((ROOT / "conf/specimen/B.yaml").read_text())
    casts = tuple(random_cast(here.arm, rng, here.camera.fps, SLOW) for _ in range(2))
    s = np.linspace(0.1, 1.0, 12) * base["length"]
    return Scene(here.arm, here.camera, base["length"], base["parameters"], casts, s, SIGMA, VERSIONS[LATEST])


def proposed(first: Diagnosis, scene: Scene, here: Experiment, rng: np.random.Generator) -> Cast:
    """The motion that a diagnosis asks for, performed and filmed with as much rest around it as was foretold."""
    tick, angles = scene.arm.tick, first.commands[list(JOINTS)].to_numpy()
    before, after = (round(here.config["diagnose"]["design"][rest] / tick) for rest in ("before", "after"))
    angles = np.concatenate([angles[:1].repeat(before, axis=0), angles, angles[-1:].repeat(after, axis=0)])
    ticks = (np.arange(len(angles)) - before) * tick
    return performed(scene.arm, ticks, angles, rng, scene.camera.fps)


def observed(scene: Scene, name: str, rng: np.random.Generator) -> np.ndarray:
    """Where points are measured with this cause hidden, (N, S, 2) [m]."""
    model = scene.model(scene.fine, named([name]))
    clean = scene.seen(model, [{f"{name}.{parameter}": size for parameter, size in HIDDEN[name].items()}])[0]
    return SIGMA * (clean + rng.standard_normal(clean.shape))


def diagnosed(scene: Scene, points: np.ndarray, here: Experiment) -> Diagnosis:
    """What is said of these points (N, S, 2) in a scene's casts."""
    bench = BlindBench(0, "effect", scene, (), {}, {}, np.nan, points, states_sigma=True)
    with tempfile.TemporaryDirectory() as folder:
        bench.write(Path(folder))
        return diagnosis(Path(folder), here.config)


def said(made: Diagnosis, name: str, when: str) -> dict[str, object]:
    """What is named, and with what probability the truth."""
    causes = " + ".join(made.causes["effect"].unique())
    return {when: f"{made.verdict}: {causes}", f"right_{when}": float(chances(made)[held(made, name)].sum())}


def odds(made: Diagnosis, name: str) -> float:
    """Log odds of the likeliest set with the cause over the likeliest without it."""
    right, chance = held(made, name), chances(made)
    return float(np.log(chance[right].max(initial=TINY) / chance[~right].max(initial=TINY)))


def chances(made: Diagnosis) -> np.ndarray:
    """Of each set of causes, (K,)."""
    return np.nan_to_num(made.theories["probability"].to_numpy())


def held(made: Diagnosis, name: str) -> np.ndarray:
    """Which sets of causes hold the one that is hidden, (K,)."""
    return np.array([name in causes.split(" + ") for causes in made.theories["causes"]])


if __name__ == "__main__":
    main()
