"""One run, or one job of a sweep, with output on the terminal and in its folder."""

from __future__ import annotations

import logging
import shlex
import sys
from pathlib import Path
from typing import Any

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
from stringcast.pipeline.run.cost import LIMIT, ask_about_cost
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.log import log_to_folder
from stringcast.pipeline.run.picture_source import use_given_source
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import conf_folders, given_names
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    refuse_inherited_limits,
    refuse_unknown_bench,
    run_moves_arm,
)
from stringcast.pipeline.settings.typed_settings import refuse_odd_paths
from stringcast.stages.workers import use_workers

# do not warn about trial names that look like dates
logging.getLogger("matplotlib").setLevel(logging.WARNING)


def main(config: DictConfig) -> float | None:
    """Perform a run, or one job of a sweep, from Hydra's settings.

    Returns the matching rate E after the last estimation, if there is one. Raises
    SystemExit if the run is refused or interrupted.
    """
    console = Terminal(stderr=True)
    folder = Path(HydraConfig.get().runtime.output_dir)
    try:
        result = run_from_config(config, console)
    except ExpectedError as error:
        print_error(error, console)
        run_folder.remove_empty_folder(folder)
        sys.exit(1)
    except KeyboardInterrupt as error:
        resume = f"python -m pipeline resume {shlex.quote(str(folder))}"
        command = with_program_name(resume)
        console.print_line(f"Interrupted. Continue after the last step: {command}")
        sys.exit(interrupt_status(error))
    if result.last_estimate is None:
        return None
    return float(result.last_estimate.fit["after"].iloc[0])


def run_from_config(config: DictConfig, console: Terminal) -> RunResult:
    """Check the settings, especially those that move an arm, then run."""
    own_settings: Any = OmegaConf.to_container(config, resolve=True)
    refuse_odd_paths(own_settings, "the command line")
    given = given_names(HydraConfig.get().overrides.task)
    if config.trials is not None and run_moves_arm(own_settings):
        refuse_unknown_bench(Path(config.trials), given)
    settings = inherit_settings(config, given)
    refuse_inherited_limits(settings, own_settings, f"trials={config.trials}")
    used_settings = use_given_source(settings, given)
    experiment = prepare_experiment(used_settings, file_of_block)
    ask_about_cost(experiment, config[LIMIT], console)
    folder = Path(HydraConfig.get().runtime.output_dir)
    return perform_run(experiment, folder, console)


def file_of_block(block: str) -> str:
    """Return the file of a block of settings, for messages."""
    hydra_config = HydraConfig.get()
    option = hydra_config.runtime.choices.get(block)
    file = f"conf/{block}/{option}.yaml" if option else "conf/config.yaml"
    for folder in conf_folders()[1:]:  # of plugins
        if option and (folder / block / f"{option}.yaml").is_file():
            file = str(folder / block / f"{option}.yaml")
    for override in hydra_config.overrides.task:
        if override.lstrip("+").startswith((f"{block}.", f"{block}=")):
            return f"{file} or the command line"
    return file


def perform_run(experiment: Experiment, folder: Path, console: Terminal) -> RunResult:
    """Perform a run in its folder; do not repeat fresh steps."""
    workers = use_workers(experiment.config["workers"])
    with run_folder.exclusive_access(folder), log_to_folder(folder), workers:
        run_folder.begin_run(experiment, folder)
        with run_folder.record_failure(folder):
            return experiment.mode.perform(experiment, folder, console)
