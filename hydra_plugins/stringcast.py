"""The one place where Hydra looks for launchers and for folders of settings."""

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin

from stringcast.pipeline.settings.composition import conf_folders
from stringcast.pipeline.sweep.lazy_launcher import LazyLauncher


class SweepLauncher(LazyLauncher):
    """Runs what is missing of a sweep."""


class PluginSettings(SearchPathPlugin):
    """Finds the settings of plugins."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Add the folders of settings of the plugins that this person named."""
        for folder in conf_folders()[1:]:
            search_path.append("stringcast-plugin", f"file://{folder}")
