"""The log of a run: its decisions with times and reasons.

It is written to run.log, and with -v to the terminal.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path

from stringcast.data.errors import escape_control_characters
from stringcast.pipeline.run.file_names import LOG_FILE

LOGGER = logging.getLogger("stringcast")
LOGGER.propagate = False  # handlers of other packages may have closed their streams
LOGGER.addHandler(logging.NullHandler())


class PrintableFormatter(logging.Formatter):
    """A formatter that escapes control characters, which act on a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record with control characters escaped."""
        return escape_control_characters(super().format(record))


LINE_FORMATTER = PrintableFormatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s")


class ForwardingHandler(logging.Handler):
    """A handler that passes the message of each line to a function."""

    def __init__(self, receive: Callable[[str], object]) -> None:
        super().__init__()
        self.receive = receive

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on the message of a record."""
        self.receive(escape_control_characters(record.getMessage()))


class LossyFileHandler(logging.FileHandler):
    """A log file that loses lines on a full disk instead of stopping the run."""

    def _open(self) -> TextIOWrapper:
        # A link in a foreign folder could overwrite any file; a pipe would block.
        no_link = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

        def open_file(path: str, flags: int) -> int:
            return os.open(path, flags | no_link, 0o666)

        return open(self.baseFilename, "a", encoding="utf-8", opener=open_file)

    def emit(self, record: logging.LogRecord) -> None:
        """Write the line of a record if possible."""
        with suppress(OSError):
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 (of logging)
        """Do nothing: the line is lost."""

    def close(self) -> None:
        """Close the file, even if its last lines are lost."""
        with suppress(OSError):
            super().close()


def add_handler(handler: logging.Handler) -> None:
    """Add a handler to the log of this package."""
    handler.setFormatter(LINE_FORMATTER)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)


def log_warnings() -> None:
    """Write the warnings of libraries into the log instead of onto the terminal."""
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").parent = LOGGER


@contextmanager
def attach_handler(handler: logging.Handler) -> Iterator[None]:
    """Add a handler to the log of this package for the duration of the context."""
    add_handler(handler)
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)
        handler.close()


@contextmanager
def log_to_folder(folder: Path) -> Iterator[None]:
    """Append the lines of the log to run.log in a folder while the context lasts."""
    file = LossyFileHandler(folder / LOG_FILE, delay=True)
    with attach_handler(file):
        try:
            yield
        except BaseException as error:
            kind = type(error).__name__
            logging.getLogger(__name__).error("stopped early: %s: %s", kind, error)
            raise
