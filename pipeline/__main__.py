"""`python -m pipeline`: compose the configuration, run, report; errors without tracebacks."""

from __future__ import annotations

import json
import sys
import uuid
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from data.schema import DataError
from pipeline import report
from pipeline.run import Result, cast, estimate_again
from pipeline.settings import UserError
from pipeline.show import bars, summary
from pipeline.world import world
from stages.generate import MotionNotFoundError
from stages.roles import HardwareError

OmegaConf.register_new_resolver("unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True)
EXPECTED = (UserError, DataError, HardwareError, MotionNotFoundError)
FROM_TRIALS = ("arm", "camera", "string", "seed", "memory", "estimate")  # settings that stored trials bring along


@hydra.main(version_base="1.3", config_path="../conf", config_name="config")
def main(config: DictConfig) -> float | None:
    """One run; a sweep calls this for each job. Returns E after the last estimation."""
    console = Console(stderr=True)
    try:
        result = run(config, console)
    except EXPECTED as error:
        console.print(f"[bold red]Error:[/] {error}", highlight=False, soft_wrap=True)
        if HydraConfig.get().mode == hydra.types.RunMode.MULTIRUN:
            return None
        sys.exit(1)
    last = result.iterations[-1].done.get("estimate")
    return None if last is None else float(last.fit["after"].iloc[0])


def run(config: DictConfig, console: Console) -> Result:
    """Check, run, report."""
    settings = with_trials_settings(OmegaConf.to_container(config, resolve=True))
    here = world(settings, where)
    folder = Path(HydraConfig.get().runtime.output_dir)
    with bars(console) as bar:
        if settings["trials"] is not None:
            result = estimate_again(here, folder, Path(settings["trials"]), bar)
        else:
            result = cast(here, folder, bar)
        with bar("report"):
            report.write(here, result)
    console.print(summary(result))
    return result


def with_trials_settings(settings: Any) -> dict[str, Any]:
    """Estimation from a run of ours takes that run's settings, except those given on the command line."""
    if settings["trials"] is None:
        return settings
    stored = Path(settings["trials"]) / "config.json"
    if not stored.exists():
        return settings
    known = json.loads(stored.read_text(encoding="utf-8"))
    given = {override.split("=")[0].lstrip("+~").split(".")[0] for override in HydraConfig.get().overrides.task}
    return settings | {name: known[name] for name in FROM_TRIALS if name not in given}


def where(block: str) -> str:
    """The file a block comes from, for messages."""
    choice = HydraConfig.get().runtime.choices.get(block)
    given = any(o.lstrip("+").startswith((f"{block}.", f"{block}=")) for o in HydraConfig.get().overrides.task)
    file = f"conf/{block}/{choice}.yaml" if choice else "conf/config.yaml"
    return f"{file} or the command line" if given else file


if __name__ == "__main__":
    main()
