"""Show what made a file: back through its inputs to settings, seed, code and packages."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.text import Text
from rich.tree import Tree

from stringcast.data import store
from stringcast.pipeline.commands.stored import run_of
from stringcast.pipeline.registry import stages
from stringcast.pipeline.settings import UserError
from stringcast.pipeline.staleness import leaves
from stringcast.pipeline.terminal import Terminal


def main(arguments: list[str]) -> int:
    """0 if all inputs are as they were, 1 if one has changed since or is gone."""
    parser = argparse.ArgumentParser("python -m pipeline lineage", description=__doc__)
    parser.add_argument("file", type=Path, help="a file of a run, or a step's folder")
    file = parser.parse_args(arguments).file
    folder = run_of(file)
    changed: list[str] = []
    tree = grown(Tree(Text(str(file))), file.resolve(), folder, changed, set())
    Terminal(highlight=False).print(tree)
    return 1 if changed else 0


def grown(tree: Tree, place: Path, run: Path, changed: list[str], shown: set[Path | str]) -> Tree:
    """A tree with what made `place`, and what made that. changed: gets the inputs that are not as they were.

    shown: places and words that stand in the tree already; they are not shown twice.
    """
    made = {} if place in shown else _origin(place, run)
    words = [line for line in _words(made) if line not in shown] if made else []
    for line in words:
        tree.add(Text(line))
    shown |= {place, *words}
    for name, digest in made.get("inputs", {}).items():
        there = _find(name, run)
        state = _state(there, digest)
        changed += [name] if state else []
        branch = tree.add(Text(f"{name}{state}{' (see above)' if there in shown else ''}"))
        if there is not None:
            grown(branch, there, _run_of(there, run), changed, shown)
    return tree


def _origin(place: Path, run: Path) -> dict[str, Any]:
    """What made a file or a step's folder; empty for what is not ours.

    What has no footer was drawn from the steps of its folder: a frame from its trial, a report from the last step.
    """
    if place.suffix == ".parquet":
        files = [place]
    elif run in (place.parent, place):
        files = sorted(run.glob("iterations/*/*/*.parquet"))[-1:]
    else:
        files = next((found for up in (place, *place.parents) if (found := sorted(up.glob("*.parquet")))), [])[:1]
    made = store.origin_of(files[0]) if files else {}
    return made if "inputs" in made else {}


def _words(made: dict[str, Any]) -> list[str]:
    """Step, seed, its own settings, code and packages, a line each."""
    step = made["step"]
    own = leaves({key: made["config"][key] for key in (step, "seed") if key in made["config"]})
    others = [name for name in stages()[step].uses if name not in (step, "seed")] if step in stages() else []
    when = f", {made['made']['at']}, {made['made']['seconds']:.1f} s" if "made" in made else ""
    return [
        f"made by {step}, seed {made['seed']}{when}",
        f"settings {_listed(own, '=')}; and {', '.join(others)} of config.json",
        f"code: commit {made['code']['commit'][:12]}, source {made['code']['source'][:12]}",
        f"packages: {_listed(made['packages'], ' ')}, Python {made['python']}",
    ]


def _listed(values: dict[str, Any], between: str) -> str:
    return ", ".join(f"{name}{between}{value}" for name, value in values.items())


def _find(name: str, run: Path) -> Path | None:
    """An input: of the run itself, or stored elsewhere."""
    return next((path.resolve() for path in (run / name, Path(name)) if path.exists()), None)


def _state(there: Path | None, digest: str) -> str:
    """Nothing where an input is what it was, else what became of it."""
    if there is None:
        return " IS GONE"
    try:
        return "" if store.content_hash(there) == digest else " HAS CHANGED SINCE"
    except store.UNREADABLE:
        return " IS DAMAGED"


def _run_of(place: Path, run: Path) -> Path:
    """The run that an input lies in; `run` itself for what lies in none."""
    try:
        return run_of(place)
    except UserError:
        return run
