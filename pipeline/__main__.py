"""`python -m pipeline`: compose the configuration and run, or hand over to a command; errors without tracebacks."""

from __future__ import annotations

import difflib
import logging
import os
import re
import signal
import sys
import uuid
from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.markup import escape
from threadpoolctl import threadpool_limits

from data import store
from data.foreign import printable
from data.schema import DataError
from pipeline import log
from pipeline.brought import check_bench, refuse_brought_limits, with_brought_settings
from pipeline.commands import NAMES, command, listed
from pipeline.keep import forget
from pipeline.perform import perform
from pipeline.run import Result
from pipeline.settings import UserError, composed, flat, names_given, refuse_twice
from pipeline.sweep.launcher import ended as sweep_ended
from pipeline.world import world
from stages.generate import MotionNotFoundError
from stages.roles import HardwareError

OmegaConf.register_new_resolver("unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True)
OmegaConf.register_new_resolver("commands", lambda *_: listed())
logging.getLogger("matplotlib").setLevel(logging.WARNING)  # it tells of names of trials that look like dates
UNANSWERED = 2  # exit status of a command that found no answer
EXPECTED = (UserError, DataError, HardwareError, MotionNotFoundError)


@hydra.main(version_base="1.3", config_path="../conf", config_name="config")
def main(config: DictConfig) -> float | None:
    """One run, or one job of a sweep. Returns E after the last estimation."""
    console = Console(stderr=True)
    try:
        result = run(config, console)
    except EXPECTED as error:
        complain(error, console)
        forget(Path(HydraConfig.get().runtime.output_dir))
        sys.exit(1)
    except KeyboardInterrupt as error:
        place = HydraConfig.get().runtime.output_dir
        console.print(f"Interrupted. To go on: python -m pipeline resume {place}", soft_wrap=True, markup=False)
        sys.exit(interrupted(error))
    last = result.iterations[-1].done.get("estimate") if result.iterations else None
    return None if last is None else float(last.fit["after"].iloc[0])


def run(config: DictConfig, console: Console) -> Result:
    """Check, run, report."""
    given = names_given(HydraConfig.get().overrides.task)
    if config.trials is not None and "execute" in config.steps:
        check_bench(Path(config.trials), given)
    settings = with_brought_settings(config, given)
    refuse_brought_limits(settings, OmegaConf.to_container(config, resolve=True), f"trials={config.trials}")
    here = world(settings, where)
    return perform(here, Path(HydraConfig.get().runtime.output_dir), console)


def where(block: str) -> str:
    """The file a block comes from, for messages."""
    choice = HydraConfig.get().runtime.choices.get(block)
    given = any(o.lstrip("+").startswith((f"{block}.", f"{block}=")) for o in HydraConfig.get().overrides.task)
    file = f"conf/{block}/{choice}.yaml" if choice else "conf/config.yaml"
    return f"{file} or the command line" if given else file


def complain(error: Exception, console: Console) -> None:
    """One clear message."""
    console.print(f"[bold red]Error:[/] {escape(printable(str(error)))}", highlight=False, soft_wrap=True)


def interrupted(by: KeyboardInterrupt) -> int:
    """Exit status after a signal, as shells have it: 130 after Ctrl-C, 143 after SIGTERM, which asks an arm to stop."""
    return 128 + int(by.args[0] if by.args else signal.SIGINT)


def asked(name: str, arguments: list[str]) -> int:
    """Hand over to a command; its exit status."""
    try:
        return int(command(name).main(arguments))
    except EXPECTED as error:
        complain(error, Console(stderr=True))
        return UNANSWERED
    except KeyboardInterrupt as error:
        return interrupted(error)


def called() -> None:
    """Hand over to a command, or run, and turn what Hydra refuses into one clear message too."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of being printed with a traceback
    threadpool_limits(1, "blas")  # its sums depend on how many threads share them; all that takes long is ours
    if "-v" in sys.argv:
        sys.argv.remove("-v")
        log.shown()
    try:
        if sys.argv[1:] and sys.argv[1] in NAMES:
            sys.exit(asked(sys.argv[1], sys.argv[2:]))
        refuse_twice(word for word in sys.argv[1:] if "=" in word and not word.startswith("-"))
        main()
        sys.exit(sweep_ended())
    except EXPECTED as error:
        sys.exit(f"Error: {error}")
    except KeyboardInterrupt as error:
        sweep_ended()
        sys.exit(interrupted(error))
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
    names = list(flat(composed()))
    near = difflib.get_close_matches(key[1], names, 1)
    remedy = f"Did you mean '{near[0]}'?" if near else "See python -m pipeline --help."
    return f"{key[1]} (command line): there is no such setting. {remedy}"


if __name__ == "__main__":
    called()
