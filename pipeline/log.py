"""What a run decided, and why: time-stamped lines of Python's `logging`, in run.log and with -v on the terminal.

Whoever decides says so to the logger of its module; who is not asked is silent.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stringcast.pipeline.folder import LOG

OURS = logging.getLogger("stringcast")
OURS.propagate = False  # to handlers of others, who may have closed what they write to
OURS.addHandler(logging.NullHandler())
LINE = logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s")


def shown() -> None:
    """From here on, lines appear on the terminal, too."""
    _heard(logging.StreamHandler())


@contextmanager
def kept(folder: Path) -> Iterator[None]:
    """Meanwhile, lines are added to the log of a run. folder: the run's."""
    handler = logging.FileHandler(folder / LOG, encoding="utf-8", delay=True)
    _heard(handler)
    try:
        yield
    except BaseException as error:
        logging.getLogger(__name__).error("ended early: %s: %s", type(error).__name__, error)
        raise
    finally:
        OURS.removeHandler(handler)
        handler.close()


def _heard(handler: logging.Handler) -> None:
    handler.setFormatter(LINE)
    OURS.addHandler(handler)
    OURS.setLevel(logging.INFO)
