"""The command line with toy stages, in child processes.

Everything but the stages is real. With disk.c preloaded, `python -m tests.faults.forked
FOLDER run:N sweep:N` lets the N-th write operation fail, or each in turn without :N. It
then checks the files, continues the run, compares the result, and prints the failed
operations.
"""

import errno
import itertools
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import traceback
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from hydra._internal.hydra import Hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from stringcast.pipeline import __main__ as shell
from stringcast.pipeline.run import single_run
from stringcast.pipeline.sweep.attempt import Attempt
from stringcast.pipeline.sweep.lazy_launcher import LazyLauncher
from stringcast.pipeline.sweep.ledger import DONE_STATE, Ledger
from stringcast.stages.report import theme
from tests.faults.strike import find_litter, look_at_what_is_left
from tests.faults.toy import ROOT, STAGES, TINY, contents

ERRORS = (  # number of the error, and whether it lasts until the command is repeated
    (errno.ENOSPC, True),
    (errno.EROFS, True),
    (errno.EACCES, True),
    (errno.ENOSPC, False),
)
REMEDY = re.compile(r"cannot be (written|locked) \((No space left|Read-only file|Permission denied).*\)\. "
                    r"(Free space on the disk, or choose|Choose)")  # fmt: skip
CHANCE = ["attempts", "seconds", "host"]  # columns of a job that differ between sweeps


class Run:
    """A run of one cast."""

    arguments = (*TINY, "max_casts=1")

    def again(self, folder):
        """Return the command that starts or continues the run."""
        return (*self.arguments, f"hydra.run.dir={folder}")

    def look(self, folder, whole):
        """Check that the files left behind are complete."""
        look_at_what_is_left(folder, whole)

    def made(self, folder):
        """Return all reproducible results."""
        return contents(folder)


class Sweep:
    """A sweep of two jobs of one cast each, without estimation."""

    arguments = (
        "--multirun",
        *TINY,
        "max_casts=1",
        "mode.stages=[generate,execute,extract]",
        "saved_outputs=[frames]",
        "seed=0,1",
    )

    def again(self, folder):
        """Return the command that starts or continues the sweep."""
        return (
            *self.arguments,
            f"hydra.sweep.dir={folder}",
            "hydra.launcher.retry=true",
        )

    def look(self, folder, whole):
        """Check that ledger entries, finished steps and tables are complete."""
        for entry in Ledger(folder).jobs():
            theirs = {
                name[13:]: digest
                for name, digest in whole["runs"].items()
                if name.startswith(entry.key)
            }
            look_at_what_is_left(folder / entry.key, theirs)
            assert entry.state != DONE_STATE or contents(folder / entry.key) == theirs
        if (folder / "sweep.parquet").exists():
            assert len(pd.read_parquet(folder / "sweep.parquet")) == 2

    def made(self, folder):
        """Return the runs, and the table without its random parts."""
        runs = {
            name: digest
            for name, digest in contents(folder).items()
            if name.count("/") and "ledger" not in name
        }
        table = pd.read_parquet(folder / "sweep.parquet").drop(columns=CHANCE)
        assert (folder / "report.html").read_text().endswith("</html>")
        return {"runs": runs, "table": table.to_json()}


def toy_experiment(*given):
    return replace(REAL(*given), stages=STAGES)


def process(attempt, entry, log, threads):
    """Make a job's process, for `Attempt._run_process`."""
    place = f"hydra.run.dir={attempt.folder / attempt.key}"
    return ended(start([*entry.overrides, "hydra.mode=RUN", place], log.fileno()))


def start(arguments, to):
    """Start a child that runs the command, with output to this file descriptor."""
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        os.dup2(to, 1)
        os.dup2(to, 2)
        # whatever a test has put in their places
        sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
        code = status(arguments)
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(code)


def get_mode(hydra, config_name, overrides):
    """Keep Hydra from composing all settings to find that no file sets a mode."""
    return RunMode.RUN if "hydra.mode=RUN" in overrides else None


def status(arguments):
    """Run the command in this process and return its exit status."""
    GlobalHydra.instance().clear()
    HydraConfig.instance().cfg = None
    LazyLauncher.current = None
    sys.argv = ["pipeline", *arguments]
    try:
        shell.cli()
    except SystemExit as end:
        if isinstance(end.code, str):
            os.write(2, f"{end.code}\n".encode())
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def ended(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def command(arguments, beside):
    """Return the exit status and output of the command.

    beside: file for the output.
    """
    with beside.open("wb") as file:
        code = ended(start(arguments, file.fileno()))
    return code, beside.read_text()


def strike(kind, folder, n, whole):
    """Let the n-th operation fail and return it; None if there are fewer."""
    number, lasts = ERRORS[n % len(ERRORS)]
    count = folder.with_suffix(".count")
    count.write_bytes(bytes(4096))
    fault = {
        "BELOW": folder,
        "AT": n,
        "ERROR": number,
        "LASTS": "1" * lasts,
        "COUNT": count,
    }
    os.environ |= {f"FAULT_{name}": str(value) for name, value in fault.items()}
    code, said = command(kind.again(folder), folder.with_suffix(".said"))
    for name in fault:
        del os.environ[f"FAULT_{name}"]
    (many,) = struct.unpack_from("q", count.read_bytes())
    if many <= n:
        return None
    struck = count.read_bytes()[8:].partition(b"\0")[0].decode()
    where = f"{n}, {errno.errorcode[number]}, {struck}: {said}"
    assert code in (0, 1), where
    assert "Traceback" not in said, where
    assert "Error executing" not in said, where
    assert code == 0 or (REMEDY.search(said) and str(folder) in said), where
    kind.look(folder, whole)
    assert command(kind.again(folder), folder.with_suffix(".said"))[0] == 0, where
    assert kind.made(folder) == whole, where
    assert not find_litter(folder), where
    shutil.rmtree(folder)
    return struck


def main(place, *asked):
    """Let operations in the folder `place` fail.

    asked: `run:N` or `sweep:N`; without N each operation fails in turn.
    """
    struck, whole = {}, {}
    for name, _, number in (word.partition(":") for word in asked):
        kind, folder = KINDS[name], place / name
        if name not in whole:
            # this process makes it, so that children inherit the modules it loads
            assert status(kind.again(folder / "whole")) == 0
            whole[name] = kind.made(folder / "whole")
        for n in [int(number)] if number else itertools.count():
            operation = strike(kind, folder / str(n), n, whole[name])
            if operation is None:
                break
            struck.setdefault(name, []).append(operation)
    print(json.dumps(struck))


def struck_by(place, *asked):
    """Run `main` in a process with disk.c preloaded; return {name: [operation]}.

    A failure shows the process's output.
    """
    if sys.platform != "linux" or shutil.which("cc") is None:
        pytest.skip("needs Linux and a C compiler (cc)")
    library, source = place / "disk.so", Path(__file__).with_name("disk.c")
    subprocess.run(
        ["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True
    )
    # this threading layer survives a fork
    around = os.environ | {
        "LD_PRELOAD": str(library),
        "NUMBA_THREADING_LAYER": "workqueue",
    }
    command = [sys.executable, "-m", "tests.faults.forked", place, *asked]
    ran = subprocess.run(
        command, cwd=ROOT, env=around, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    return json.loads(ran.stdout)


KINDS = {"run": Run(), "sweep": Sweep()}

if __name__ == "__main__":
    REAL, single_run.prepare_experiment = single_run.prepare_experiment, toy_experiment
    # as Hydra expects when the module is run
    shell.main.__wrapped__.__module__ = "__main__"
    Attempt._run_process = process
    Hydra.get_mode = get_mode
    # Pictures of a page are left empty: to draw them takes most of a run.
    empty = SimpleNamespace(print_svg=lambda data, metadata: data.write("<svg></svg>"))
    theme.FigureCanvasSVG = lambda figure: empty
    # imported here once for all children
    import_module("stringcast.pipeline.run.report")
    import_module("stringcast.pipeline.sweep.finish")
    main(Path(sys.argv[1]), *sys.argv[2:])
