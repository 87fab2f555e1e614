"""Whether a step that is on the disk is what would be made now, and why not.

Nothing here asks a clock: a step is stale if an input's content, a setting, a source file or a package is another than
its footers say. What has the same content is the same, whenever it was written.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stringcast.data import store
from stringcast.data.schema import DataError
from stringcast.pipeline.iterations import Step
from stringcast.pipeline.layout import place_of
from stringcast.pipeline.origin import origin
from stringcast.pipeline.registry import stages
from stringcast.pipeline.settings import UserError, leaves
from stringcast.pipeline.sources import sources

LAB = "hardware.virtual."  # what it does can be done again, to the bit


@dataclass(frozen=True)
class Found:
    """What is on the disk of a step. artifact: None where there is none that can be read. reasons: why it is not to be
    used as it is; none if it is fresh."""

    artifact: Any
    reasons: tuple[str, ...] = ()


def look(config: Mapping[str, Any], folder: Path, step: Step) -> Found:
    """A step's artifact in a run's folder, and what has changed since it was made. config: the run's settings."""
    place = folder / step.place
    if not place.is_dir():
        return Found(None, ("it has not been made yet",))
    try:
        artifact: Any = store.load(step.stage.makes, place)
        made = [store.origin_of(file) for file in sorted(place.glob("*.parquet"))]
    except DataError as error:
        return Found(None, (str(error),))
    return Found(artifact, tuple(changes(made[0], made_now(config, folder, step), step.stage.uses)))


def reasons_of(folder: Path, place: Path, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Why a stored step would be made again, by its files and the run's settings alone: no model is built of these."""
    try:
        made = store.origin_of(sorted(place.glob("*.parquet"))[0])
        stage = stages()[made["step"]]
        store.load(stage.makes, place)
        config = {key: settings[key] for key in stage.uses}
        now = origin(config, made["step"], made["seed"], _there(folder, made["inputs"], settings["trials"]))
        return tuple(changes(made, now | {"sources": sources(config, stage)}, stage.uses))
    except KeyError as error:
        return (f"it or the settings lack {error}: another version of this code made the run",)
    except (DataError, UserError, *store.UNREADABLE) as error:
        return (str(error),)


def _there(folder: Path, paths: Mapping[str, str], trials: str | None) -> dict[str, str]:
    """Content hashes of those of the paths that lie in the run's folder, or in that of its stored trials, which
    begin as `trials` does."""
    homes = [Path(home).resolve() for home in (folder, trials) if home is not None]
    places = {path: (folder / path if path.startswith("iterations/") else Path(path)).resolve() for path in paths}
    known = {path: place for path, place in places.items() if any(place.is_relative_to(home) for home in homes)}
    return {path: store.content_hash(place) for path, place in known.items() if place.is_dir() or place.is_file()}


def made_now(config: Mapping[str, Any], folder: Path, step: Step) -> dict[str, Any]:
    """The origin that a step would have if it were made now."""
    used = {key: config[key] for key in step.stage.uses}
    made = origin(config, step.stage.name, step.seed(int(config["seed"])), inputs(folder, step))
    return made | {"sources": sources(used, step.stage)}


def changes(made: Mapping[str, Any], now: Mapping[str, Any], uses: Sequence[str]) -> list[str]:
    """What differs between two origins, in words. uses: the settings that count."""
    if "sources" not in made:
        return ["its files do not say of which sources they were made"]
    settings = (leaves({key: o["config"].get(key) for key in uses}) for o in (made, json.loads(json.dumps(now))))
    return [
        *_differing("input", made["inputs"], now["inputs"], "has another content"),
        *(f"setting {key} was {a}, is {b}" for key, a, b in pairs(*settings)),
        *_differing("source", made["sources"], now["sources"], "has changed"),
        *(f"package {key} was {a}, is {b}" for key, a, b in pairs(made["packages"], now["packages"])),
        *([] if made["python"] == now["python"] else [f"Python was {made['python']}, is {now['python']}"]),
    ]


def pairs(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Names whose values differ, with both values; 'absent' where there is none."""
    names = [*a, *(name for name in b if name not in a)]
    both = [(name, a.get(name, "absent"), b.get(name, "absent")) for name in names]
    return [(name, one, other) for name, one, other in both if one != other]


def _differing(what: str, a: Mapping[str, str], b: Mapping[str, str], words: str) -> Iterator[str]:
    """The same of hashes, which say nothing to people."""
    for name, one, other in pairs(a, b):
        yield f"{what} {name} {'is new' if one == 'absent' else 'is gone' if other == 'absent' else words}"


def inputs(folder: Path, step: Step) -> dict[str, str]:
    """Content hashes of all that a step looks at, by path: in the run's folder, and of what was stored elsewhere."""
    there = [place for place in step.places if (folder / place).is_dir()]
    return {place.as_posix(): store.content_hash(folder / place) for place in there} | dict(step.hashes)


def repeatable(config: Mapping[str, Any], artifact: str) -> bool:
    """Whether an artifact can be made again: all but what a real arm and camera did."""
    return artifact != "trial" or str(config["hardware"]["_target_"]).startswith(LAB)


def performed(config: Mapping[str, Any], folder: Path, number: int, artifact: str) -> bool:
    """Whether a real arm has moved by an artifact of an iteration: then it stays, for what was measured hangs on it."""
    nearest = number if artifact in ("motion", "trial") else number + 1
    return not repeatable(config, "trial") and (folder / place_of(nearest, "trial")).is_dir()
