"""The one place where Hydra looks for launchers. What ours does is in `pipeline.sweep`."""

from stringcast.pipeline.sweep.begun import BegunLater


class Ledger(BegunLater):
    """Runs what is missing of a sweep."""
