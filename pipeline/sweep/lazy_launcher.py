"""Launch sweeps with code that is loaded only for a sweep.

Hydra loads this module for every command line.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any, ClassVar

from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher


class LazyLauncher(Launcher):
    """A launcher that delegates to `pipeline.sweep.launcher.LedgerLauncher`."""

    current: ClassVar[Any] = None  # the launcher of this process' sweep

    def __init__(self, **settings: Any) -> None:
        """Store the launcher's settings."""
        module = import_module("stringcast.pipeline.sweep.launcher")
        self.launcher = module.LedgerLauncher(**settings)

    def setup(self, **arguments: Any) -> None:
        """Store Hydra's objects for `launch`, and check the settings."""
        LazyLauncher.current = self.launcher
        self.launcher.setup(**arguments)

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Run the missing jobs and return the last matching rate E of each, or NaN."""
        return self.launcher.launch(job_overrides, initial_job_idx)


def sweep_folder() -> str:
    """Return the folder of this process' sweep, for errors without it."""
    if LazyLauncher.current is None:
        return "the run's folder"
    return str(LazyLauncher.current.config.hydra.sweep.dir)


def finish_sweep() -> int:
    """Finish this process' sweep, if any, and return the exit status."""
    if LazyLauncher.current is None:
        return 0
    return int(LazyLauncher.current.finish_sweep())
