"""The pinned version of Hydra and its refusals.

Foreign settings may only name callables of fixed lists
(`pipeline/settings/allowed_callables.py`); Hydra's own list is a second defence. Its
gaps are tested, too. If they change, reconsider the pin.
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


def test_required_locked_and_installed_version_agree():
    assert pinned() == f"hydra-core=={version('hydra-core')}"
    locked = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    assert any(line.split()[:1] == [pinned()] for line in locked)


@pytest.mark.parametrize(
    "target", ["os.system", "subprocess.run", "builtins.exec", "builtins.eval"]
)
def test_hydra_refuses_commands(target):
    with pytest.raises(InstantiationException, match="blocklisted"):
        instantiate({"_target_": target, "_partial_": True})


@pytest.mark.parametrize(
    "target", ["numpy.load", "pathlib.Path.write_text", "builtins.open"]
)
def test_hydra_alone_would_run_code(target):
    """Hydra would call these, so fixed lists are needed."""
    instantiate({"_target_": target, "_partial_": True})
