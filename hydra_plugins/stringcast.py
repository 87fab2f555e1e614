"""The one place where Hydra looks for launchers. What ours does is in `pipeline.sweep`."""

from pipeline.sweep.launcher import LedgerLauncher


class Ledger(LedgerLauncher):
    """Runs what is missing of a sweep."""
