"""Allowed imports between rooms.

Data imports nothing of ours, stages import data, hardware imports the model, and only
the shell imports Hydra.
"""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = {
    "data": {"data"},
    "stages": {"data", "stages"},
    "hardware": {"data", "stages", "hardware"},
    "pipeline": {"data", "stages", "hardware", "pipeline", "hydra", "omegaconf"},
}
GUARDED = set(ALLOWED) | {"hydra", "omegaconf", "serial", "dynamixel_sdk"}


def imported(file: Path) -> set[str]:
    """Return rooms and packages of everything that a file imports, wherever in it."""
    nodes = list(ast.walk(ast.parse(file.read_text())))
    plain = {
        alias.name
        for node in nodes
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    names = plain | {n.module or "" for n in nodes if isinstance(n, ast.ImportFrom)}
    return {name.removeprefix("stringcast.").split(".")[0] for name in names}


@pytest.mark.parametrize("room", ALLOWED)
def test_a_room_knows_only_the_rooms_below_it(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    allowed = ALLOWED[room] | ({"serial"} if room == "hardware" else set())
    for file in files:
        assert imported(file) & GUARDED <= allowed, file


def test_hardware_knows_nothing_of_the_stages_but_the_model_and_what_a_device_must_do():
    for file in sorted((ROOT / "hardware").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "stringcast.stages"
            ):
                assert re.match(
                    r"stringcast\.stages\.(model\b|execute\.interfaces$)", node.module
                ), f"{file}: {node.module}"


def test_no_module_knows_one_that_knows_it():
    """No cycle of imports exists between modules.

    Imports for types and those inside functions count: modules that need one another
    cannot be understood one at a time.
    """
    files = {
        file: name(file) for room in ALLOWED for file in (ROOT / room).rglob("*.py")
    }
    modules = set(files.values())
    known = {name: modules_in(file, modules) - {name} for file, name in files.items()}
    assert sum(map(len, known.values())) > 1000
    assert known["stringcast.stages.model.effects.wind"] == {
        "stringcast.stages.model.effect"
    }
    try:
        TopologicalSorter(known).prepare()
    except CycleError as error:
        pytest.fail(" knows ".join(reversed(error.args[1])))


def test_the_picture_of_the_rooms_shows_what_they_import():
    """The picture of the rooms shows their imports.

    Arrows that follow from others are left out, and those of the shell are not all
    imports. A room that is not drawn is a user's own stage; none of ours may import it.
    """
    arrows = re.findall(
        r"^    (.+) --> (.+)$", (ROOT / "stages" / "README.md").read_text(), re.M
    )
    drawn = {
        (one, other)
        for left, right in arrows
        for one in left.split(" & ")
        for other in right.split(" & ")
    }
    below = {one: {other for begin, other in drawn if begin == one} for one, _ in drawn}
    known = {}
    for file in (
        file for room in ("stages", "hardware") for file in (ROOT / room).rglob("*.py")
    ):
        names = {
            place
            for module in imports_of(file)
            if (place := room_of(module.split(".")[1:]))
        }
        known.setdefault(room_of(file.relative_to(ROOT).parts), set()).update(names)
    for room in known.keys() - {None, "data"}:
        needed = {
            name
            for name in known[room] - {room}
            if not any(name in beneath(known, b) for b in known[room] - {room, name})
        }
        if room in below:
            assert below[room] == needed, room
        else:
            assert not any(room in known[other] for other in known.keys() - {room}), (
                f"{room} is not drawn"
            )


def room_of(parts):
    """Return the room of a file: a folder beneath `stages` or at the top level.

    It is None for a file directly in `stages`.
    """
    if parts[0] != "stages":
        return parts[0]
    return (
        parts[1] if len(parts) > 1 and (ROOT / "stages" / parts[1]).is_dir() else None
    )


def imports_of(file: Path) -> set[str]:
    """Return our modules that a file imports from."""
    nodes = [
        node
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom)
    ]
    return {
        node.module for node in nodes if (node.module or "").startswith("stringcast.")
    }


def beneath(known: dict, room: str) -> set[str]:
    """Return all rooms that a room imports, directly or indirectly."""
    return set().union(
        *({one} | beneath(known, one) for one in known.get(room, set()) - {room})
    )


def name(file: Path) -> str:
    """Return a module's name."""
    return ".".join(
        ("stringcast", *file.relative_to(ROOT).with_suffix("").parts)
    ).removesuffix(".__init__")


def modules_in(file: Path, modules: set[str]) -> set[str]:
    """Return our modules that a file imports, wherever in it.

    `from package import module` counts as an import of the module.
    """
    nodes = [
        node
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom)
    ]
    names = [
        (node.module or "", f"{node.module}.{alias.name}")
        for node in nodes
        for alias in node.names
    ]
    return {full if full in modules else module for module, full in names} & modules
