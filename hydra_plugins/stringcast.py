"""The one place where Hydra looks for launchers; ours is in `pipeline.sweep`."""

from stringcast.pipeline.sweep.lazy_launcher import LazyLauncher


class LedgerLauncher(LazyLauncher):
    """Runs what is missing of a sweep."""
