"""`python -m pipeline`: hand over to a command, to the help or to a run; errors without
tracebacks.

Each of these is loaded when it is asked for: a run needs what takes seconds to load, a
question little of it.
"""

from __future__ import annotations

import os
import sys
import uuid
from importlib import import_module
from typing import Any

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from threadpoolctl import threadpool_limits

from stringcast.data.errors import ExpectedError, escape_control_characters, remedy_for
from stringcast.pipeline.cli.command_line_hints import refuse_mistakes
from stringcast.pipeline.cli.terminal import (
    Terminal,
    explain_hydra_error,
    interrupt_status,
    print_error,
    with_program_name,
)
from stringcast.pipeline.commands import COMMAND_NAMES, load_command
from stringcast.pipeline.run import log
from stringcast.pipeline.settings.composition import refuse_repeated_settings
from stringcast.pipeline.sweep.lazy_launcher import finish_sweep as sweep_ended
from stringcast.pipeline.sweep.lazy_launcher import sweep_folder as sweep_folder

OmegaConf.register_new_resolver(
    "unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True
)
NO_ANSWER_STATUS = 2  # exit status of a command that found no answer


@hydra.main(
    version_base="1.3", config_path="pkg://stringcast.conf", config_name="config"
)
def main(config: DictConfig) -> float | None:
    """One run, or one job of a sweep. Returns E after the last estimation."""
    rate: float | None = limit_blas_threads(
        import_module("stringcast.pipeline.run.single_run")
    ).main(config)
    return rate


def limit_blas_threads(module: Any) -> Any:
    """The module, with the BLAS that was loaded with it kept to one thread: its sums
    depend on how many share them, and all that takes long is ours.
    """
    threadpool_limits(1, "blas")
    return module


def run_command(name: str, arguments: list[str]) -> int:
    """Hand over to a command; its exit status."""
    try:
        status: int = limit_blas_threads(load_command(name))(arguments)
        return status
    except ExpectedError as error:
        print_error(error, Terminal(stderr=True))
        return NO_ANSWER_STATUS
    except KeyboardInterrupt as error:
        return interrupt_status(error)


def cli() -> None:
    """Hand over, and turn what Hydra refuses into one clear message too."""
    # what it warns of is said in one line of ours
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    # errors come here instead of being printed with a traceback
    os.environ["HYDRA_FULL_ERROR"] = "1"
    if "-v" in sys.argv:
        sys.argv.remove("-v")
        log.show_log_on_terminal()
    words = sys.argv[1:]
    try:
        if words and words[0] in COMMAND_NAMES:
            sys.exit(run_command(words[0], words[1:]))
        refuse_mistakes(words)
        overrides = [word for word in words if "=" in word and not word.startswith("-")]
        refuse_repeated_settings(overrides)
        if {"-h", "--help"} & {*words}:
            print(
                import_module("stringcast.pipeline.cli.help_page").help_text(overrides)
            )
            return
        main()
        sys.exit(sweep_ended())
    except ExpectedError as error:
        sys.exit(f"Error: {with_program_name(escape_control_characters(str(error)))}")
    except KeyboardInterrupt as error:
        sweep_ended()
        sys.exit(interrupt_status(error))
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(
            f"Error: {with_program_name(escape_control_characters(explain_hydra_error(error)))}"
        )
    except OSError as error:
        what = escape_control_characters(str(error.filename or sweep_folder()))
        remedy = f"{remedy_for(error)} with hydra.run.dir or hydra.sweep.dir."
        sys.exit(
            f"Error: {what}: cannot be written ({error.strerror or error}). {remedy}"
        )
    except MemoryError as error:
        sys.exit(
            f"Error: more memory is needed than there is ({error}). Ask for fewer points, frames or candidates."
        )


if __name__ == "__main__":
    cli()
