"""`python -m pipeline`: start a run, a command or the help.

Errors are printed without tracebacks. Modules that import slowly are imported only when
needed.
"""

from __future__ import annotations

import logging
import os
import sys
import uuid
from importlib import import_module
from importlib.metadata import version
from typing import NoReturn

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from threadpoolctl import threadpool_limits

from stringcast.data.errors import ExpectedError, escape_control_characters, remedy_for
from stringcast.pipeline.cli.command_line_hints import join_quoted, refuse_mistakes
from stringcast.pipeline.cli.terminal import (
    Terminal,
    explain_hydra_error,
    interrupt_status,
    print_error,
    with_program_name,
)
from stringcast.pipeline.commands import COMMAND_NAMES, load_command
from stringcast.pipeline.run import log
from stringcast.pipeline.run.stopping import repeat_ignored_interrupts
from stringcast.pipeline.settings.composition import refuse_repeated_settings
from stringcast.pipeline.sweep.lazy_launcher import finish_sweep, sweep_folder

OmegaConf.register_new_resolver(
    "unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True
)
PLUGINS_WORD = "plugins="
NO_ANSWER_STATUS = 2  # exit status of a command without an answer


@hydra.main(
    version_base="1.3", config_path="pkg://stringcast.conf", config_name="config"
)
def main(config: DictConfig) -> float | None:
    """Perform one run, or one job of a sweep; return E after the last estimation."""
    single_run = import_module("stringcast.pipeline.run.single_run")
    limit_blas_threads()
    return single_run.main(config)


def limit_blas_threads() -> None:
    """Limit loaded BLAS libraries to one thread, as their sums depend on the number."""
    threadpool_limits(1, "blas")


def run_command(name: str, arguments: list[str]) -> int:
    """Run a command and return its exit status."""
    try:
        command = load_command(name)
        limit_blas_threads()
        return command(arguments)
    except ExpectedError as error:
        print_error(error, Terminal(stderr=True))
        return NO_ANSWER_STATUS
    except KeyboardInterrupt as error:
        return interrupt_status(error)


def exit_with_error(message: str) -> NoReturn:
    """Exit with a message; its commands start as this program was called."""
    sys.exit(f"Error: {with_program_name(escape_control_characters(message))}")


def start(words: list[str]) -> None:
    """Start the run, the command or the help of a command line."""
    if words == ["--version"]:
        print(f"stringcast {version('stringcast')}")
        return
    if words and words[0] in COMMAND_NAMES:
        sys.exit(run_command(words[0], words[1:]))
    overrides = [word for word in words if "=" in word and not word.startswith("-")]
    if any(word.lstrip("+").startswith(PLUGINS_WORD) for word in overrides):
        named_plugins = import_module("stringcast.pipeline.settings.named_plugins")
        named_plugins.name_plugins(overrides)
    refuse_mistakes(words)
    refuse_repeated_settings(overrides)
    if "-h" in words or "--help" in words:
        help_page = import_module("stringcast.pipeline.cli.help_page")
        print(help_page.help_text(overrides))
        return
    main()
    sys.exit(finish_sweep())


def cli() -> None:
    """Start the command line, and explain errors in one message."""
    # Our messages replace OpenCV's warnings.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    # Hydra raises errors instead of printing tracebacks.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    repeat_ignored_interrupts()
    log.log_warnings()
    if "-v" in sys.argv:
        sys.argv.remove("-v")
        log.add_handler(logging.StreamHandler())
    words = join_quoted(sys.argv[1:])
    sys.argv[1:] = words
    try:
        start(words)
    except ExpectedError as error:
        exit_with_error(str(error))
    except KeyboardInterrupt as error:
        finish_sweep()
        sys.exit(interrupt_status(error))
    except (HydraException, OmegaConfBaseException) as error:
        exit_with_error(explain_hydra_error(error))
    except OSError as error:
        path = escape_control_characters(str(error.filename or sweep_folder()))
        remedy = f"{remedy_for(error)} with hydra.run.dir or hydra.sweep.dir."
        sys.exit(
            f"Error: {path}: cannot be written ({error.strerror or error}). {remedy}"
        )
    except MemoryError as error:
        sys.exit(
            f"Error: more memory is needed than there is ({error}). "
            "Ask for fewer points, frames or candidates."
        )


if __name__ == "__main__":
    cli()
