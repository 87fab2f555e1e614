"""Errors that are no bugs, and how a person is told of them. Every command loads this:
it needs nothing itself.
"""

from __future__ import annotations

import errno

DEFAULT_REMEDY = "Look at the disk, or choose another folder"
REMEDIES = {
    errno.ENOSPC: "Free space on the disk, or choose another folder",
    errno.EDQUOT: "Free space within your quota, or choose another folder",
    errno.EACCES: "Choose a folder that you may write to",
    errno.EPERM: "Choose a folder that you may write to",
    errno.EROFS: "Choose a folder that you may write to",
}


class ExpectedError(Exception):
    """An error that the user can correct: the message names the place, what is wrong
    there and the remedy.
    """


def remedy_for(error: BaseException) -> str:
    """The remedy for a place that cannot be written, from the error's number."""
    return REMEDIES.get(getattr(error, "errno", None) or 0, DEFAULT_REMEDY)


def escape_control_characters(text: str) -> str:
    """A text that others wrote, its control characters spelt out: an escape sequence
    would steer the terminal.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)
