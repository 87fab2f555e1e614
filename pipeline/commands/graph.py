"""Print the stages of a run with these settings, and where their inputs come from."""

from __future__ import annotations

from typing import Any

from omegaconf import OmegaConf

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.named_plugins import name_plugins
from stringcast.pipeline.settings.typed_settings import build_chosen


def main(arguments: list[str]) -> int:
    """Print the graph; return 0."""
    parser = CommandParser("python -m pipeline graph", description=__doc__)
    parser.add_argument(
        "settings", nargs="*", help="settings of the run, such as +experiment=stringB"
    )
    overrides = parser.parse_args(arguments).settings
    name_plugins(overrides)
    composed = OmegaConf.create(compose_settings(overrides))
    settings: Any = OmegaConf.to_container(composed, resolve=True)
    mode = build_chosen(settings["mode"], "mode", "conf/mode")
    sources = mode.graph(settings).describe_sources()
    lines = [f"{stage}: {text}" for stage, text in sources.items()]
    for line in lines or ["This run has a single stage."]:
        Terminal().print_line(line)
    return 0
