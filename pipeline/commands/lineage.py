"""Show what made a file: inputs, settings, seed, code and packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from rich.text import Text
from rich.tree import Tree

from stringcast.data import store
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.commands.stored_runs import enclosing_run, run_folder_of
from stringcast.pipeline.run.provenance import PARTS_OF_ORIGIN, UNKNOWN_CODE
from stringcast.pipeline.settings.composition import flatten_settings
from stringcast.pipeline.settings.stage_registry import stages


def main(arguments: list[str]) -> int:
    """Print a tree of origins; return 0 if no input has changed."""
    parser = CommandParser("python -m pipeline lineage", description=__doc__)
    parser.add_argument("file", type=Path, help="a file of a run, or a step's folder")
    file: Path = parser.parse_args(arguments).file
    tree = Tree(Text(str(file)))
    hash_of = cache(store.content_hash)  # footers may name a folder repeatedly
    place, run = file.resolve(), run_folder_of(file)
    has_changed = add_origin(tree, place, run, set(), hash_of)
    Terminal(highlight=False).print(tree)
    return 1 if has_changed else 0


def add_origin(
    tree: Tree,
    place: Path,
    run: Path,
    shown: set[Path | str],
    hash_of: Callable[[Path], str],
) -> bool:
    """Add the origin of a file and of all its inputs to a tree or a branch.

    `run` is the folder of its run; `shown` are places and lines already shown, extended
    here. Returns whether an input has changed.
    """
    origin = {} if place in shown else origin_of_file(place, run)
    shown.add(place)
    if origin and place.is_dir() and store.images_not_kept(place):
        tree.add(Text("its frames were not kept"))
    for line in describe_origin(origin) if origin else []:
        if line not in shown:
            tree.add(Text(line))
            shown.add(line)

    has_changed = False
    for name, digest in origin.get("inputs", {}).items():
        paths = [path.resolve() for path in (run / name, Path(name)) if path.exists()]
        # do not read folders that are not inputs of steps
        paths = [path for path in paths if path.is_file() or path.is_relative_to(run)]
        if not paths:
            tree.add(Text(f"{name} IS GONE"))
            has_changed = True
            continue
        path = paths[0]
        state = change_of(path, digest, hash_of)
        seen = " (see above)" if path in shown else ""
        branch = tree.add(Text(f"{name}{state}{seen}"))
        input_run = enclosing_run(path) or run
        has_changed |= bool(state)
        has_changed |= add_origin(branch, path, input_run, shown, hash_of)
    return has_changed


def change_of(path: Path, digest: str, hash_of: Callable[[Path], str]) -> str:
    """Describe how a path differs from its hash; empty if it does not."""
    try:
        return "" if hash_of(path) == digest else " HAS CHANGED SINCE"
    except store.READ_ERRORS:
        return " IS DAMAGED"


def origin_of_file(place: Path, run: Path) -> dict[str, Any]:
    """Return the origin of a file or a step's folder; empty for foreign files.

    A file without a footer has the origin of a step: a frame that of its trial, a
    report that of the last step.
    """
    files: list[Path] = []
    if place.suffix == ".parquet":
        files = [place]
    elif run in (place.parent, place):
        files = sorted(run.glob("iterations/*/*/*.parquet"))[-1:]
    else:
        for folder in (place, *place.parents):
            files = sorted(folder.glob("*.parquet"))
            if files:
                break
    origin = store.read_origin(files[0]) if files else {}
    return origin if origin.keys() >= PARTS_OF_ORIGIN else {}


def describe_origin(origin: Mapping[str, Any]) -> list[str]:
    """Return lines with step, seed, settings, code and packages."""
    step, config = origin["step"], origin["config"]
    code = UNKNOWN_CODE | origin["code"]
    made_by = f"made by {step}, seed {origin['seed']}"
    if "made" in origin:
        made_by += f", {origin['made']['at']}, {origin['made']['seconds']:.1f} s"
    own_names = [name for name in (step, "seed") if name in config]
    own_settings = flatten_settings({name: config[name] for name in own_names})
    used = stages()[step].uses if step in stages() else ()
    other_names = [name for name in used if name not in (step, "seed")]
    settings = ", ".join(f"{name}={value}" for name, value in own_settings.items())
    packages = [f"{name} {version}" for name, version in origin["packages"].items()]
    return [
        made_by,
        f"settings {settings}; and {', '.join(other_names)} of config.json",
        f"code: commit {code['commit'][:12]}, source {code['source'][:12]}",
        f"packages: {', '.join(packages)}, Python {origin['python']}",
    ]
