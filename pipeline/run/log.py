"""The log of a run: decisions and their reasons with times, in run.log and with -v on the terminal."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import cast

from stringcast.data.errors import escape_control_characters
from stringcast.pipeline.run.file_names import LOG_FILE

LOGGER = logging.getLogger("stringcast")
LOGGER.propagate = False  # handlers of others may have closed what they write to
LOGGER.addHandler(logging.NullHandler())


class PrintableFormatter(logging.Formatter):
    """A formatter that escapes control characters, which could steer the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return escape_control_characters(super().format(record))


LINE_FORMATTER = PrintableFormatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s")


class ForwardingHandler(logging.Handler):
    """A handler that passes the message of each line to a function."""

    def __init__(self, receive: Callable[[str], object]) -> None:
        super().__init__()
        self.receive = receive

    def emit(self, record: logging.LogRecord) -> None:
        self.receive(escape_control_characters(record.getMessage()))


class LossyFileHandler(logging.FileHandler):
    """A log file on a disk that may be full: it loses lines rather than stop a run."""

    def _open(self) -> TextIOWrapper:
        # A link in the folder of somebody else could lead lines into any file of the user.
        no_link = getattr(os, "O_NOFOLLOW", 0)

        def open_file(path: str, flags: int) -> int:
            return os.open(path, flags | no_link, 0o666)

        file = open(
            self.baseFilename, self.mode, encoding=self.encoding, opener=open_file
        )
        return cast(TextIOWrapper, file)

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 (its name in logging)
        pass

    def close(self) -> None:
        with suppress(OSError):
            super().close()


def add_handler(handler: logging.Handler) -> None:
    """Add a handler to the log of this package."""
    handler.setFormatter(LINE_FORMATTER)
    LOGGER.addHandler(handler)
    LOGGER.setLevel(logging.INFO)


def show_log_on_terminal() -> None:
    """Print the lines of the log on the terminal from now on."""
    add_handler(logging.StreamHandler())


@contextmanager
def log_to_folder(folder: Path) -> Iterator[None]:
    """Append the lines of the log to run.log in a run's folder for the duration of the context."""
    handler = LossyFileHandler(folder / LOG_FILE, encoding="utf-8", delay=True)
    add_handler(handler)
    try:
        yield
    except BaseException as error:
        logging.getLogger(__name__).error(
            "stopped early: %s: %s", type(error).__name__, error
        )
        raise
    finally:
        LOGGER.removeHandler(handler)
        handler.close()


@contextmanager
def forward_log(receive: Callable[[str], object]) -> Iterator[None]:
    """Pass every line of the log to a function for the duration of the context."""
    handler = ForwardingHandler(receive)
    add_handler(handler)
    try:
        yield
    finally:
        LOGGER.removeHandler(handler)
