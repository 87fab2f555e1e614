"""What made a file: configuration, seed, inputs, code and packages."""

from __future__ import annotations

import hashlib
import platform
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "numba", "scipy", "opencv-python-headless", "pandas", "pyarrow", "hydra-core", "cmaes", "pydantic")
CODE = ("data", "hardware", "pipeline", "stages")


def origin(config: Mapping[str, Any], step: str, seed: int, inputs: Mapping[str, str]) -> dict[str, Any]:
    """Everything needed to make the same again. inputs: content hashes by name."""
    return {
        "step": step,
        "seed": seed,
        "inputs": dict(inputs),
        "config": config,
        "code": code(),
        "packages": versions(PACKAGES),
        "python": platform.python_version(),
    }


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Installed versions by name."""
    return {name: _version(name) for name in packages}


_version = cache(version)  # which reads a file each time


@cache
def code() -> dict[str, str]:
    """The commit, if known, and a hash of the source files as they are."""
    digest = hashlib.sha256()
    for file in sorted(p for folder in CODE for p in (ROOT / folder).rglob("*.py")):
        digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes())
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    return {"commit": commit.stdout.strip() or "unknown", "source": digest.hexdigest()}


@cache
def state() -> str:
    """The commit, if known, with a + behind it where sources are no longer as it has them."""
    asked = ["git", "status", "--porcelain", "--", *CODE]
    changed = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False).stdout
    sources = [line for line in changed.splitlines() if line.endswith(".py")]
    return code()["commit"] + ("+" if sources else "")
