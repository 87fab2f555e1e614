"""Go on with a run that was interrupted or failed, with its own settings."""

from __future__ import annotations

from pathlib import Path

from stringcast.pipeline.commands import Arguments
from stringcast.pipeline.commands.stored import stored_experiment
from stringcast.pipeline.inherited import refuse_inherited_limits
from stringcast.pipeline.run import perform
from stringcast.pipeline.settings import composed
from stringcast.pipeline.terminal import Terminal


def main(arguments: list[str]) -> int:
    """Go on with a run; 0 when it has ended."""
    parser = Arguments("python -m pipeline resume", description=__doc__)
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("--accept-limits", action="store_true", help="move a real arm by the limits stored there")
    asked = parser.parse_args(arguments)
    here = stored_experiment(asked.run)
    own = composed() | {"accept_limits": asked.accept_limits}
    refuse_inherited_limits(here.config, own, str(asked.run), "--accept-limits")
    perform(here, asked.run, Terminal(stderr=True))
    return 0
