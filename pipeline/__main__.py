"""`python -m pipeline`: hand over to a command, to the help or to a run; errors without tracebacks.

Each of these is loaded when it is asked for: a run needs what takes seconds to load, a question little of it.
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

from stringcast.data.errors import ExpectedError, printable, remedy_for
from stringcast.pipeline import log
from stringcast.pipeline.commands import NAMES, command
from stringcast.pipeline.mistakes import refuse_mistakes
from stringcast.pipeline.settings import refuse_twice
from stringcast.pipeline.sweep.begun import ended as sweep_ended
from stringcast.pipeline.sweep.begun import folder as sweep_folder
from stringcast.pipeline.terminal import Terminal, as_called, complain, interrupted, refusal

OmegaConf.register_new_resolver("unique", lambda *_: uuid.uuid4().hex[:6], use_cache=True)
UNANSWERED = 2  # exit status of a command that found no answer


@hydra.main(version_base="1.3", config_path="pkg://stringcast.conf", config_name="config")
def main(config: DictConfig) -> float | None:
    """One run, or one job of a sweep. Returns E after the last estimation."""
    rate: float | None = one_thread(import_module("stringcast.pipeline.run")).main(config)
    return rate


def one_thread(module: Any) -> Any:
    """The module, with the BLAS that was loaded with it kept to one thread: its sums depend on how many share them, and
    all that takes long is ours."""
    threadpool_limits(1, "blas")
    return module


def asked(name: str, arguments: list[str]) -> int:
    """Hand over to a command; its exit status."""
    try:
        return one_thread(command(name))(arguments)
    except ExpectedError as error:
        complain(error, Terminal(stderr=True))
        return UNANSWERED
    except KeyboardInterrupt as error:
        return interrupted(error)


def called() -> None:
    """Hand over, and turn what Hydra refuses into one clear message too."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # what it warns of is said in one line of ours
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of being printed with a traceback
    if "-v" in sys.argv:
        sys.argv.remove("-v")
        log.shown()
    words = sys.argv[1:]
    try:
        if words and words[0] in NAMES:
            sys.exit(asked(words[0], words[1:]))
        refuse_mistakes(words)
        overrides = [word for word in words if "=" in word and not word.startswith("-")]
        refuse_twice(overrides)
        if {"-h", "--help"} & {*words}:
            print(import_module("stringcast.pipeline.help").page(overrides))
            return
        main()
        sys.exit(sweep_ended())
    except ExpectedError as error:
        sys.exit(f"Error: {as_called(printable(str(error)))}")
    except KeyboardInterrupt as error:
        sweep_ended()
        sys.exit(interrupted(error))
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(f"Error: {as_called(printable(refusal(error)))}")
    except OSError as error:
        what = printable(str(error.filename or sweep_folder()))
        remedy = f"{remedy_for(error)} with hydra.run.dir or hydra.sweep.dir."
        sys.exit(f"Error: {what}: cannot be written ({error.strerror or error}). {remedy}")
    except MemoryError as error:
        sys.exit(f"Error: more memory is needed than there is ({error}). Ask for fewer points, frames or candidates.")


if __name__ == "__main__":
    called()
