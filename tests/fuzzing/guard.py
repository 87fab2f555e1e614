"""Run a command on hostile files: no traceback, no hang, no write elsewhere."""

import contextlib
import io
import os
import signal
import sys
import tempfile
from pathlib import Path

from stringcast.data.errors import ExpectedError

# of a command: many times the processor time that it needs, and for one that waits
PROCESSOR_LIMIT_S = 60
WALL_LIMIT_S = 900
# events, and how many of their arguments are paths that are changed
WRITES = {
    "os.remove": 1,
    "os.rename": 2,
    "os.mkdir": 1,
    "os.rmdir": 1,
    "os.link": 2,
    "os.symlink": 2,
    "os.truncate": 1,
    "os.chmod": 1,
    "shutil.rmtree": 1,
}
WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# of compiled code, fonts and the version of the code: they do not depend on the files
OWN_CACHES = ("__pycache__", "numba_cache", "matplotlib")
ALLOWED_PROGRAMS = ("git",)


class TooSlowError(BaseException):
    """A command did not end in time; no code catches this."""


class Watch:
    """Record writes outside a folder, from Python's audit events."""

    def __init__(self):
        self.inside = None  # the folder that may be written; nothing is watched before
        self.faults = []
        sys.addaudithook(self.hear)

    def hear(self, event, arguments):
        """Record an event that writes outside, starts a program or opens a socket."""
        if self.inside is None:
            return
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, str | bytes) and flags & WRITE_FLAGS:
                self.note(event, path)
        elif event in ("os.remove", "os.rmdir") and arguments[1] >= 0:
            pass  # relative to an open folder: of shutil.rmtree, which is noted
        elif event in WRITES:
            for path in arguments[: WRITES[event]]:
                self.note(event, path)
        elif event == "subprocess.Popen" and arguments[0] not in ALLOWED_PROGRAMS:
            self.faults.append(f"{event} {arguments[0]}")
        elif event in ("os.system", "socket.connect", "os.exec"):
            self.faults.append(f"{event} {arguments}")

    def note(self, event, path):
        """Record a path outside the folder."""
        if not isinstance(path, str | bytes | os.PathLike):
            return
        place = Path(os.path.realpath(os.fsdecode(path)))
        is_own = any(name in place.parts for name in OWN_CACHES)
        if is_own or place == Path(os.devnull):
            return
        if not place.is_relative_to(self.inside):
            self.faults.append(f"{event} {place}")


WATCH = Watch()


def stop(number, frame):
    raise TooSlowError


def run_guarded(command, words, inside):
    """Run a command on hostile files and return its status, or the error's message.

    Parameters
    ----------
    command : callable
        Takes the words of its command line.
    words : list of str
        The words.
    inside : Path
        The only folder in which files may be written.
    """
    temporary = inside / "tmp"
    temporary.mkdir(exist_ok=True)
    timers = (
        (signal.SIGPROF, signal.ITIMER_PROF, PROCESSOR_LIMIT_S),
        (signal.SIGALRM, signal.ITIMER_REAL, WALL_LIMIT_S),
    )
    former = {number: signal.signal(number, stop) for number, *_ in timers}
    tempfile.tempdir = str(temporary)
    WATCH.faults.clear()
    WATCH.inside = inside.resolve()
    for _, timer, limit in timers:
        signal.setitimer(timer, limit)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            outcome = command(words)
    except ExpectedError as error:
        outcome = str(error)
        assert outcome.strip(), "an error without a message"
    except SystemExit as end:  # of a command line that cannot be read
        outcome = end.code
    finally:
        for number, timer, _ in timers:
            signal.setitimer(timer, 0)
            signal.signal(number, former[number])
        WATCH.inside = None
        tempfile.tempdir = None
    assert not WATCH.faults, WATCH.faults
    return outcome
