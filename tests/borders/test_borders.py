"""Who may know whom: data nobody, stages data, hardware the model; the shell alone knows Hydra."""

import ast
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
    """Rooms and packages of all that a file imports, wherever in it."""
    nodes = list(ast.walk(ast.parse(file.read_text())))
    plain = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names = plain | {n.module or "" for n in nodes if isinstance(n, ast.ImportFrom)}
    return {name.removeprefix("stringcast.").split(".")[0] for name in names}


@pytest.mark.parametrize("room", ALLOWED)
def test_a_room_knows_only_the_rooms_below_it(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    allowed = ALLOWED[room] | ({"serial"} if room == "hardware" else set())
    for file in files:
        assert imported(file) & GUARDED <= allowed, file


def test_hardware_knows_nothing_of_the_stages_but_model_and_roles():
    for file in sorted((ROOT / "hardware").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("stringcast.stages"):
                assert node.module.split(".")[2] in ("model", "roles"), f"{file}: {node.module}"
