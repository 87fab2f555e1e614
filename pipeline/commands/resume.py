"""Continue a run that was interrupted or failed, with its own settings."""

from __future__ import annotations

from pathlib import Path

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import COST_OPTION, CommandParser, add_cost_option
from stringcast.pipeline.commands.stored_runs import read_stored_experiment
from stringcast.pipeline.run.cost import ask_about_cost
from stringcast.pipeline.run.single_run import perform_run
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.pipeline.settings.settings_from_runs import refuse_inherited_limits


def main(arguments: list[str]) -> int:
    """Continue a run; return 0 when it has ended."""
    parser = CommandParser("python -m pipeline resume", description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument(
        "--accept-limits",
        action="store_true",
        help="move a real arm by the limits stored there",
    )
    add_cost_option(parser)
    options = parser.parse_args(arguments)
    experiment = read_stored_experiment(options.run)
    settings = compose_settings() | {"accept_limits": options.accept_limits}
    refuse_inherited_limits(
        experiment.config, settings, str(options.run), "--accept-limits"
    )
    console = Terminal(stderr=True)
    ask_about_cost(experiment, options.max_core_hours, console, COST_OPTION)
    perform_run(experiment, options.run, console)
    return 0
