"""The loop: iterate until the real tip is in the box or the budget is spent (II-A).

Everything an iteration makes is on disk before the next step begins. A step whose artifact
is there already is read, not made again: an interrupted run goes on where it stopped, with
the same result, for every step's seed is its own.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

from data import dataset, store
from data.artifacts import Diagnosis, Motion, Observation, Points, Trial
from data.schema import DataError
from pipeline.origin import origin
from pipeline.steps import STEPS, Past, Progress, step_seed
from pipeline.world import World
from stages.judge import Verdict, judge

EXTENDED = "extended.yaml"  # the model that a diagnosis made
Bar = Callable[[str], AbstractContextManager[Progress]]
FOLDERS = {
    "generate": "motion",
    "execute": "trial",
    "extract": "points",
    "estimate": "estimate",
    "diagnose": "diagnosis",
}


@dataclass(frozen=True)
class Iteration:
    """One manipulation: its artifacts by step, and whether the tip hit."""

    number: int
    done: dict[str, Any] = field(repr=False)
    verdict: Verdict | None = None

    @property
    def name(self) -> str:
        """Name of its trial."""
        return f"t{self.number:02d}"

    @property
    def refused(self) -> str:
        """Why nothing is learned from its trial; empty if it can be trusted."""
        link = self.done["execute"].link.iloc[0] if "execute" in self.done else {"valid": True}
        return "" if link["valid"] else str(link["reason"])

    @property
    def hit(self) -> bool:
        """Whether the tip reached the target in a trial that can be trusted."""
        return self.verdict is not None and self.verdict.hit and not self.refused

    @property
    def observation(self) -> Observation:
        """Its trial as estimation sees it."""
        trial, points = self.done["execute"], self.done["extract"]
        return Observation(self.name, points.points, points.readings, points.masks, arm=trial.arm)


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    folder: Path
    iterations: tuple[Iteration, ...]
    sentence: str

    @property
    def diagnosis(self) -> Diagnosis | None:
        """What was found, if it was asked."""
        return self.iterations[-1].done.get("diagnose")

    @property
    def hit(self) -> bool:
        """Whether the real tip reached the target."""
        return any(i.hit for i in self.iterations)


def cast(world: World, folder: Path, bar: Bar) -> Result:
    """Cast until it hits or the manipulations are spent."""
    begin(world, folder)
    iterations: list[Iteration] = []
    while len(iterations) < world.config["manipulations"] and not (iterations and iterations[-1].hit):
        iterations.append(_iterate(world, folder, iterations, bar))
        _publish(world, folder, iterations)
    return _finish(folder, iterations)


def estimate_again(world: World, folder: Path, trials: Path, bar: Bar) -> Result:
    """Estimation alone, from stored trials: each in turn, beginning with the one before it.

    Points are made from a trial's frames where it has no points, or where `steps` asks for it.
    """
    data = _usable(world, trials)
    begin(world, folder)
    iterations: list[Iteration] = []
    observations: list[Observation] = []
    for number, stored in enumerate(data.trials.values(), start=1):
        last = iterations[-1].done["estimate"] if iterations else None
        past = Past(number, {}, None, last, tuple(observations), data.films.get(stored.trial), data.hashes)
        done, observation = _read_again(world, folder, stored, past, bar)
        observations.append(observation)
        past = replace(past, done=done, observations=tuple(observations[-world.config["memory"] :]))
        iterations.append(Iteration(number, done | {"estimate": _step(world, folder, "estimate", past, bar)}))
    rates = [float(i.done["estimate"].fit["after"].iloc[0]) for i in iterations]
    sentence = f"Estimated from {len(iterations)} trial(s) of {trials.name}; the matching rate E is {rates[-1]:.3f}."
    left = f" Left out: {_reasons(data.rejected)}." if data.rejected else ""
    return _ended(folder, iterations, sentence + left)


def diagnose(world: World, folder: Path, trials: Path, bar: Bar) -> Result:
    """The diagnosis of stored trials, and what it leaves in the run's folder: diagnosis.json and extended.yaml."""
    data = _usable(world, trials)
    begin(world, folder)
    observations: list[Observation] = []
    iterations: list[Iteration] = []
    for number, stored in enumerate(data.trials.values(), start=1):
        past = Past(number, {}, None, None, tuple(observations), data.films.get(stored.trial), data.hashes)
        done, observation = _read_again(world, folder, stored, past, bar)
        observations.append(observation)
        iterations.append(Iteration(number, done))
    past = replace(past, observations=tuple(observations), rejected=data.rejected, held_out=_held_out(data))
    made: Diagnosis = _step(world, folder, "diagnose", past, bar)
    iterations[-1].done["diagnose"] = made
    store.write_text(folder / "diagnosis.json", str(made.finding["diagnosis"].iloc[0]))
    store.write_text(folder / EXTENDED, str(made.finding["extended"].iloc[0]))
    left = f" Left out: {_reasons(data.rejected)}." if data.rejected else ""
    return _ended(folder, iterations, made.sentence + left)


def _held_out(data: dataset.Dataset) -> tuple[str, ...]:
    """Trials that dataset.yaml sets aside."""
    roles = data.about.get("trials") or {}
    return tuple(str(name) for name, about in roles.items() if (about or {}).get("role") == "held_out")


def _usable(world: World, trials: Path) -> dataset.Dataset:
    """Stored trials that fit this string; raises DataError where there are none."""
    data = dataset.fits(dataset.read(trials), world.string.length)
    if not data.trials:
        reasons = _reasons(data.rejected) or "it holds no trial"
        raise DataError(f"trials={trials}: no trial can be used ({reasons}). Look at the files it names.")
    return data


def _reasons(rejected: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in rejected.items())


def _read_again(
    world: World, folder: Path, stored: Observation, past: Past, bar: Bar
) -> tuple[dict[str, Any], Observation]:
    """What was extracted, if anything was, and the observation with its points."""
    asked = "extract" in world.config["steps"]
    if past.film is None or not (stored.points.empty or asked):
        return {}, stored
    points = _step(world, folder, "extract", past, bar)
    return {"extract": points}, replace(stored, points=points.points, readings=points.readings, masks=points.masks)


def begin(world: World, folder: Path) -> None:
    """Make the run's folder, or see that it is this run's."""
    path = folder / "config.json"
    text = json.dumps(world.config, indent=2, sort_keys=True)
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise DataError(
            f"{folder}: this folder holds a run with other settings (see config.json). "
            "Leave hydra.run.dir to its default, or repeat the settings of that run."
        )
    store.write_text(path, text)


def _iterate(world: World, folder: Path, before: list[Iteration], bar: Bar) -> Iteration:
    """One manipulation, step by step. Nothing is estimated from a trial that cannot be trusted."""
    current = Iteration(len(before) + 1, {})
    estimates = [i.done["estimate"] for i in before if "estimate" in i.done]
    for name in world.config["steps"]:
        if name == "estimate" and current.refused:
            continue
        seen = [i for i in (*before, current) if "extract" in i.done and not i.refused]
        past = Past(
            current.number,
            current.done,
            before[-1].done["generate"] if before else None,
            estimates[-1] if estimates else None,
            tuple(i.observation for i in seen[-world.config["memory"] :]),
        )
        current.done[name] = _step(world, folder, name, past, bar)
    motion: Motion = current.done["generate"]
    points: Points = current.done["extract"]
    return Iteration(current.number, current.done, judge(points, world.target, world.obstacles, motion.duration))


def _step(world: World, folder: Path, name: str, past: Past, bar: Bar) -> Any:
    """Read a step's artifact if it is there, else make and store it."""
    step = STEPS[name]
    place = folder / _place(past.number, name)
    if place.is_dir():
        return store.load(step.kind, place)
    with bar(f"{past.number}. {name}") as progress:
        seed = step_seed(world.seed, past.number, name)
        made = step.make(world, past, seed, progress)
        store.save(made, place, origin(world.config, name, seed, _inputs(world, folder, past)))
    return store.load(step.kind, place)


def _inputs(world: World, folder: Path, past: Past) -> dict[str, str]:
    """Content hashes of all that a step may have looked at, by path: this iteration so far, what the last ones
    within memory left, and what was stored elsewhere."""
    this = [_place(past.number, step) for step in past.done]
    recent = range(max(past.number - max(world.config["memory"], 2) + 1, 1), past.number)
    earlier = [_place(number, step) for number in recent for step in FOLDERS]
    there = [place for place in (*earlier, *this) if (folder / place).is_dir()]
    return {place.as_posix(): _hash(folder / place) for place in there} | dict(past.hashes)


@cache
def _hash(artifact: Path) -> str:
    """Content hash of an artifact, which never changes once it is there."""
    return store.content_hash(artifact)


def _place(number: int, step: str) -> Path:
    """The folder of a step's artifact, relative to the run's."""
    return Path("iterations") / f"{number:02d}" / FOLDERS[step]


def _publish(world: World, folder: Path, iterations: list[Iteration]) -> None:
    """Keep the run a dataset that others can read."""
    trials: dict[str, tuple[Trial, Points]] = {i.name: (i.done["execute"], i.done["extract"]) for i in iterations}
    camera = {k: world.config["camera"][k] for k in ("fps", "width", "height", "px_per_m", "origin_px", "distortion")}
    about = {
        "name": world.config["name"],
        "string": {"length": world.string.length},
        "arm": {"links": list(world.arm.links), "base": list(world.arm.base)},
        "camera": camera,
    }
    refused = {i.name: {"invalid": i.refused} for i in iterations if i.refused}
    about |= {"trials": refused} if refused else {}
    places = {i.name: _place(i.number, "execute") for i in iterations}
    inputs = {path.as_posix(): _hash(folder / path) for i in iterations for path in _sources(i.number)}
    dataset.publish(folder, trials, places, about, origin(world.config, "dataset", world.seed, inputs))


def _sources(number: int) -> tuple[Path, Path]:
    """What the dataset's tables are made of."""
    return _place(number, "execute"), _place(number, "extract")


def _finish(folder: Path, iterations: list[Iteration]) -> Result:
    """Say how it ended."""
    last = iterations[-1]
    assert last.verdict is not None
    tries = f"{len(iterations)} manipulation{'s' if len(iterations) > 1 else ''}"
    if last.hit:
        sentence = f"The tip reached the target in manipulation {last.number}."
    else:
        sentence = f"The tip did not reach the target in {tries}; the budget is spent."
    return _ended(folder, iterations, sentence)


def _ended(folder: Path, iterations: list[Iteration], sentence: str) -> Result:
    """Write run.json: the run in a few numbers."""
    result = Result(folder, tuple(iterations), sentence)
    rows = []
    for i in iterations:
        fit = i.done["estimate"].fit.iloc[0] if "estimate" in i.done else {}
        row = {"number": i.number, "E_before": fit.get("before"), "E_after": fit.get("after")}
        if i.verdict is not None:
            row |= {"hit": i.hit, "miss_m": i.verdict.distance, "t_closest": i.verdict.t}
            row |= {"touched": i.verdict.touched}
        row = {name: None if isinstance(value, float) and not isfinite(value) else value for name, value in row.items()}
        rows.append(row)
    store.write_text(
        folder / "run.json", json.dumps({"hit": result.hit, "sentence": sentence, "iterations": rows}, indent=2)
    )
    return result
