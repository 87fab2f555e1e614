"""One run, or one job of a sweep, from the settings that Hydra has composed to its end,
on the terminal and in its folder.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from stringcast.data.errors import ExpectedError
from stringcast.pipeline.cli.terminal import (
    Terminal,
    interrupt_status,
    print_error,
    with_program_name,
)
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.log import log_to_folder
from stringcast.pipeline.run.picture_source import refuse_unusable_source
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import given_names
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    refuse_inherited_limits,
    refuse_unknown_bench,
    run_moves_arm,
)

# it tells of names of trials that look like dates
logging.getLogger("matplotlib").setLevel(logging.WARNING)


def main(config: DictConfig) -> float | None:
    """E after the last estimation, if there is one. Ends the process where the run is
    refused or interrupted.
    """
    console = Terminal(stderr=True)
    try:
        result = run_from_config(config, console)
    except ExpectedError as error:
        print_error(error, console)
        run_folder.remove_empty_folder(Path(HydraConfig.get().runtime.output_dir))
        sys.exit(1)
    except KeyboardInterrupt as error:
        place = HydraConfig.get().runtime.output_dir
        said = f"Interrupted. What was finished is kept in {place}; the step under way begins anew with"
        console.print(
            with_program_name(f"{said}: python -m pipeline resume {place}"),
            soft_wrap=True,
            markup=False,
        )
        sys.exit(interrupt_status(error))
    return (
        None
        if result.last_estimate is None
        else float(result.last_estimate.fit["after"].iloc[0])
    )


def run_from_config(config: DictConfig, console: Terminal) -> RunResult:
    """Check settings of what moves an arm, then run and report."""
    given = given_names(HydraConfig.get().overrides.task)
    if config.trials is not None and run_moves_arm(
        OmegaConf.to_container(config, resolve=True)
    ):
        refuse_unknown_bench(Path(config.trials), given)
    settings = inherit_settings(config, given)
    refuse_inherited_limits(
        settings,
        OmegaConf.to_container(config, resolve=True),
        f"trials={config.trials}",
    )
    refuse_unusable_source(settings, given)
    here = prepare_experiment(settings, file_of_block)
    return perform_run(here, Path(HydraConfig.get().runtime.output_dir), console)


def file_of_block(block: str) -> str:
    """The file a block comes from, for messages."""
    choice = HydraConfig.get().runtime.choices.get(block)
    given = any(
        o.lstrip("+").startswith((f"{block}.", f"{block}="))
        for o in HydraConfig.get().overrides.task
    )
    file = f"conf/{block}/{choice}.yaml" if choice else "conf/config.yaml"
    return f"{file} or the command line" if given else file


def perform_run(experiment: Experiment, folder: Path, console: Terminal) -> RunResult:
    """Run and report; what is in `folder` already is not made again."""
    with run_folder.exclusive_access(folder), log_to_folder(folder):
        run_folder.begin_run(experiment, folder)
        with run_folder.record_failure(folder):
            return experiment.mode.perform(experiment, folder, console)
