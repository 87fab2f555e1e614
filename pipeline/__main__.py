"""`python -m pipeline`: compose the configuration, run, report; errors without tracebacks."""

from __future__ import annotations

import difflib
import os
import re
import shutil
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hydra
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.markup import escape

from data import store
from data.schema import DataError
from pipeline import report
from pipeline.brought import brought_along, extended_model
from pipeline.run import Result, begin, cast, diagnose, estimate_again
from pipeline.settings import UserError
from pipeline.show import bars, summary
from pipeline.study import command as study
from pipeline.sweep.launcher import ended as sweep_ended
from pipeline.world import World, world
from stages.generate import MotionNotFoundError
from stages.roles import HardwareError

OmegaConf.register_new_resolver("unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True)
INTERRUPTED = 130  # exit status after Ctrl-C, as shells have it
EXPECTED = (UserError, DataError, HardwareError, MotionNotFoundError)


@hydra.main(version_base="1.3", config_path="../conf", config_name="config")
def main(config: DictConfig) -> float | None:
    """One run, or one job of a sweep. Returns E after the last estimation."""
    console = Console(stderr=True)
    try:
        result = run(config, console)
    except EXPECTED as error:
        console.print(f"[bold red]Error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        forget(Path(HydraConfig.get().runtime.output_dir))
        sys.exit(1)
    except KeyboardInterrupt:
        place = HydraConfig.get().runtime.output_dir
        console.print(f"Interrupted. To go on, give the same command with hydra.run.dir={place}", soft_wrap=True)
        sys.exit(INTERRUPTED)
    last = result.iterations[-1].done.get("estimate") if result.iterations else None
    return None if last is None else float(last.fit["after"].iloc[0])


def run(config: DictConfig, console: Console) -> Result:
    """Check, run, report."""
    settings = with_trials_settings(config)
    here = world(settings, where)
    folder = Path(HydraConfig.get().runtime.output_dir)
    if settings["steps"] == ["study"]:
        return blind_study(here, folder, console)
    with bars(console) as bar:
        if "diagnose" in settings["steps"]:
            result = diagnose(here, folder, Path(settings["trials"]), bar)
        elif settings["trials"] is not None:
            result = estimate_again(here, folder, Path(settings["trials"]), bar)
        else:
            result = cast(here, folder, bar)
        with bar("report"):
            report.write(here, result)
    console.print(summary(result))
    return result


def blind_study(here: World, folder: Path, console: Console) -> Result:
    """Its scores on the terminal, its tables and pictures in the folder."""
    begin(here, folder)
    with bars(console) as bar, bar("blind study") as progress:
        sentence = study.run(here, folder, progress)
    console.print(sentence, soft_wrap=True)
    return Result(folder, (), sentence)


def forget(folder: Path) -> None:
    """Remove the folder of a run that was refused before it made anything."""
    if folder.is_dir() and {file.name for file in folder.iterdir()} <= {"config.json"}:
        shutil.rmtree(folder)


def with_trials_settings(config: DictConfig) -> Any:
    """All settings. Stored trials bring some along; what is given on the command line stands."""
    whole = OmegaConf.create(OmegaConf.to_container(config))  # unresolved: what refers to a setting follows it
    if config.trials is not None:
        given = {override.split("=")[0].lstrip("+~") for override in HydraConfig.get().overrides.task}
        for name, value in brought_along(Path(config.trials), given).items():
            OmegaConf.update(whole, name, value, merge=False)
    if config.extended is not None:
        for name, value in extended_model(Path(config.extended)).items():
            OmegaConf.update(whole, name, value, merge=True)
    if config.trials is not None or config.extended is not None:
        given = {override.split("=")[0].lstrip("+~") for override in HydraConfig.get().overrides.task}
        for name in sorted(given & set(flat(OmegaConf.to_container(config)))):
            OmegaConf.update(whole, name, OmegaConf.select(config, name))
    return OmegaConf.to_container(whole, resolve=True)


def where(block: str) -> str:
    """The file a block comes from, for messages."""
    choice = HydraConfig.get().runtime.choices.get(block)
    given = any(o.lstrip("+").startswith((f"{block}.", f"{block}=")) for o in HydraConfig.get().overrides.task)
    file = f"conf/{block}/{choice}.yaml" if choice else "conf/config.yaml"
    return f"{file} or the command line" if given else file


def called() -> None:
    """Run, and turn what Hydra refuses into one clear message too."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of being printed with a traceback
    try:
        main()
        sys.exit(sweep_ended())
    except EXPECTED as error:
        sys.exit(f"Error: {error}")
    except KeyboardInterrupt:
        sweep_ended()
        sys.exit(INTERRUPTED)
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"Error: {refusal(error)}")
    except OSError as error:
        remedy = f"{store.remedy_for(error)} with hydra.run.dir."
        sys.exit(f"Error: {error.filename}: cannot be written ({error.strerror}). {remedy}")


def refusal(error: BaseException) -> str:
    """What Hydra says, with the nearest setting there is."""
    said = str(error).strip().splitlines()[0]
    key = re.match(r"Could not override '([^']+)'", said)
    if key is None:
        said = "\n".join(line for line in str(error).splitlines() if line.strip() and "provider" not in line)
        return said.removesuffix("Config search path:").strip()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(Path(__file__).resolve().parents[1] / "conf"), version_base="1.3"):
        names = list(flat(OmegaConf.to_container(compose("config"))))
    near = difflib.get_close_matches(key[1], names, 1)
    remedy = f"Did you mean '{near[0]}'?" if near else "See python -m pipeline --help."
    return f"{key[1]} (command line): there is no such setting. {remedy}"


def flat(block: Any, place: str = "") -> Iterator[str]:
    """Names of all settings, with dots."""
    for name, value in block.items():
        yield f"{place}{name}"
        if isinstance(value, dict):
            yield from flat(value, f"{place}{name}.")


if __name__ == "__main__":
    called()
