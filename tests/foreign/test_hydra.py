"""Hydra is the version whose refusals were tested.

Another version may call anything, or refuse more.

Classes of foreign settings come from fixed lists
(`pipeline/settings/allowed_callables.py`), so that this list is the second defence and
not the first. Its gaps are tested too. When it closes a gap, or no longer holds the
rest, the pin must be reconsidered.
"""

import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from hydra.errors import InstantiationException
from hydra.utils import instantiate

ROOT = Path(__file__).resolve().parents[2]


def pinned() -> str:
    """Return the version that pyproject.toml pins."""
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]["dependencies"]
    return next(one for one in asked if one.startswith("hydra-core"))


def test_one_version_is_asked_for_locked_and_installed():
    assert pinned() == f"hydra-core=={version('hydra-core')}"
    locked = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    assert any(line.split()[:1] == [pinned()] for line in locked)


@pytest.mark.parametrize(
    "target", ["os.system", "subprocess.run", "builtins.exec", "builtins.eval"]
)
def test_hydra_refuses_what_runs_a_command(target):
    with pytest.raises(InstantiationException, match="blocklisted"):
        instantiate({"_target_": target, "_partial_": True})


@pytest.mark.parametrize(
    "target", ["numpy.load", "pathlib.Path.write_text", "builtins.open"]
)
def test_hydra_alone_would_not_do(target):
    """Hydra alone would not suffice.

    It would call these whatever a file says, so fixed lists come first.
    """
    instantiate({"_target_": target, "_partial_": True})
