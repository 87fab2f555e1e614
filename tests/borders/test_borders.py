"""Who may know whom: data nobody, stages data, hardware the model; the shell alone
knows Hydra.
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
# lines of a function's body, and of all of it: more are not read at a glance


def imported(file: Path) -> set[str]:
    """Rooms and packages of all that a file imports, wherever in it."""
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
    """Imports for types and those inside functions count: what cannot be read alone
    cannot be understood alone.
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
    """Arrows that follow from others are left out, and those of the shell are not all
    imports. A room that is not drawn is a stage of one's own: none of ours stands on
    it.
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
    """A folder beneath `stages`, or a room of the first floor; None for a file of its
    own in `stages`.
    """
    if parts[0] != "stages":
        return parts[0]
    return (
        parts[1] if len(parts) > 1 and (ROOT / "stages" / parts[1]).is_dir() else None
    )


def imports_of(file: Path) -> set[str]:
    """Our modules that a file imports from."""
    nodes = [
        node
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom)
    ]
    return {
        node.module for node in nodes if (node.module or "").startswith("stringcast.")
    }


def beneath(known: dict, room: str) -> set[str]:
    """All that a room stands on, however far."""
    return set().union(
        *({one} | beneath(known, one) for one in known.get(room, set()) - {room})
    )


def name(file: Path) -> str:
    """A module's name."""
    return ".".join(
        ("stringcast", *file.relative_to(ROOT).with_suffix("").parts)
    ).removesuffix(".__init__")


def modules_in(file: Path, modules: set[str]) -> set[str]:
    """Those of our modules that a file imports, wherever in it; `from package import
    module` is of the module.
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
