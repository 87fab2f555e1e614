"""One run, or one job of a sweep, from the settings that Hydra has composed to its end, on the terminal and in its
folder."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from stringcast.data.errors import ExpectedError
from stringcast.pipeline import run_folder
from stringcast.pipeline.experiment import Experiment, prepare
from stringcast.pipeline.filmed import refuse_source
from stringcast.pipeline.inherited import check_bench, moves, refuse_inherited_limits, with_inherited_settings
from stringcast.pipeline.log import kept
from stringcast.pipeline.result import Result
from stringcast.pipeline.settings import names_given
from stringcast.pipeline.terminal import Terminal, as_called, complain, interrupted

logging.getLogger("matplotlib").setLevel(logging.WARNING)  # it tells of names of trials that look like dates


def main(config: DictConfig) -> float | None:
    """E after the last estimation, if there is one. Ends the process where the run is refused or interrupted."""
    console = Terminal(stderr=True)
    try:
        result = run(config, console)
    except ExpectedError as error:
        complain(error, console)
        run_folder.forget(Path(HydraConfig.get().runtime.output_dir))
        sys.exit(1)
    except KeyboardInterrupt as error:
        place = HydraConfig.get().runtime.output_dir
        said = f"Interrupted. What was finished is kept in {place}; the step under way begins anew with"
        console.print(as_called(f"{said}: python -m pipeline resume {place}"), soft_wrap=True, markup=False)
        sys.exit(interrupted(error))
    return None if result.estimate is None else float(result.estimate.fit["after"].iloc[0])


def run(config: DictConfig, console: Terminal) -> Result:
    """Check settings of what moves an arm, then run and report."""
    given = names_given(HydraConfig.get().overrides.task)
    if config.trials is not None and moves(OmegaConf.to_container(config, resolve=True)):
        check_bench(Path(config.trials), given)
    settings = with_inherited_settings(config, given)
    refuse_inherited_limits(settings, OmegaConf.to_container(config, resolve=True), f"trials={config.trials}")
    refuse_source(settings, given)
    here = prepare(settings, where)
    return perform(here, Path(HydraConfig.get().runtime.output_dir), console)


def where(block: str) -> str:
    """The file a block comes from, for messages."""
    choice = HydraConfig.get().runtime.choices.get(block)
    given = any(o.lstrip("+").startswith((f"{block}.", f"{block}=")) for o in HydraConfig.get().overrides.task)
    file = f"conf/{block}/{choice}.yaml" if choice else "conf/config.yaml"
    return f"{file} or the command line" if given else file


def perform(experiment: Experiment, folder: Path, console: Terminal) -> Result:
    """Run and report; what is in `folder` already is not made again."""
    with run_folder.alone(folder), kept(folder):
        run_folder.begin(experiment, folder)
        with run_folder.failing(folder):
            return experiment.mode.perform(experiment, folder, console)
