"""The log of a run: decisions and their reasons, time-stamped, by Python's `logging`,
in run.log and with -v on the terminal.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Any, cast

from stringcast.data.errors import escape_control_characters
from stringcast.pipeline.run.file_names import LOG_FILE

LOGGER = logging.getLogger("stringcast")
# to handlers of others, who may have closed what they write to
LOGGER.propagate = False
LOGGER.addHandler(logging.NullHandler())


class PrintableFormatter(logging.Formatter):
    """A line of which no part steers the terminal on which it is read."""

    def format(self, record: logging.LogRecord) -> str:
        return escape_control_characters(super().format(record))


LINE_FORMATTER = PrintableFormatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s")


def show_log_on_terminal() -> None:
    """Show the log's lines on the terminal, too, from here on."""
    add_handler(logging.StreamHandler())


@contextmanager
def log_to_folder(folder: Path) -> Iterator[None]:
    """Meanwhile, lines are added to the log of a run. folder: the run's."""
    handler = LossyFileHandler(folder / LOG_FILE, encoding="utf-8", delay=True)
    add_handler(handler)
    try:
        yield
    except BaseException as error:
        logging.getLogger(__name__).error(
            "ended early: %s: %s", type(error).__name__, error
        )
        raise
    finally:
        LOGGER.removeHandler(handler)
        handler.close()


@contextmanager
def forward_log(by: Callable[[str], object]) -> Iterator[None]:
    """Meanwhile, every line is told to a function."""
    handler = ForwardingHandler(by)
    add_handler(handler)
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)


class ForwardingHandler(logging.Handler):
    """Hands lines on, without time and place."""

    def __init__(self, by: Callable[[str], object]) -> None:
        super().__init__()
        self.by = by

    def emit(self, record: logging.LogRecord) -> None:
        self.by(escape_control_characters(record.getMessage()))


class LossyFileHandler(logging.FileHandler):
    """A log on a disk that may be full: it loses lines rather than stop a run, or hide
    what did.
    """

    def _open(self) -> TextIOWrapper:
        """The file itself: through a link in a folder of others, lines would go into
        any file of ours.
        """
        no_link = getattr(os, "O_NOFOLLOW", 0)
        how: dict[str, Any] = {
            "opener": lambda path, flags: os.open(path, flags | no_link, 0o666)
        }
        return cast(
            TextIOWrapper,
            open(self.baseFilename, self.mode, encoding=self.encoding, **how),
        )

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 (its name in logging)
        pass

    def close(self) -> None:
        with suppress(OSError):
            super().close()


def add_handler(handler: logging.Handler) -> None:
    handler.setFormatter(LINE_FORMATTER)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)
