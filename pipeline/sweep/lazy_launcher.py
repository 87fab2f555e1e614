"""The part of sweeps that Hydra loads for every command line; what launches them is
loaded for a sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any, ClassVar

from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher


class LazyLauncher(Launcher):
    """A launcher that hands all to `pipeline.sweep.launcher.LedgerLauncher`."""

    current: ClassVar[Any] = None  # the launcher of this process' sweep

    def __init__(self, **settings: Any) -> None:
        """Take the launcher's settings."""
        self.launcher = import_module(
            "stringcast.pipeline.sweep.launcher"
        ).LedgerLauncher(**settings)

    def setup(self, **given: Any) -> None:
        """Take what Hydra hands over before `launch`, and check the settings; raises
        UserError.
        """
        LazyLauncher.current = self.launcher
        self.launcher.setup(**given)

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Run what is missing of these jobs. Each returns E after its last estimation,
        NaN if there is none.
        """
        jobs: Sequence[JobReturn] = self.launcher.launch(job_overrides, initial_job_idx)
        return jobs


def sweep_folder() -> str:
    """The folder of this process' sweep, for errors of which Hydra does not say where
    it writes.
    """
    return (
        "the run's folder"
        if LazyLauncher.current is None
        else str(LazyLauncher.current.config.hydra.sweep.dir)
    )


def finish_sweep() -> int:
    """Write table and page of this process' sweep, if it had one, and say how it
    stands: 0 if all its jobs are done.
    """
    return (
        0 if LazyLauncher.current is None else int(LazyLauncher.current.finish_sweep())
    )
