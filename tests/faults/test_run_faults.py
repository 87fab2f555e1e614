"""Runs survive all faults at all file operations."""

import ast
import json
import os
import signal
from contextlib import suppress
from datetime import UTC, datetime
from multiprocessing import get_context

import numpy as np
import pytest

from stringcast.data.schema import DataError
from stringcast.pipeline.modes import Cast
from stringcast.pipeline.run import run_folder
from tests.faults.kills import Forked, rounds
from tests.faults.strike import KINDS, STEPS, Faults, strike
from tests.faults.toy import ROOT, Killed, contents, toy_experiment, toy_run

CLOCKS = {
    "time",
    "time_ns",
    "now",
    "utcnow",
    "today",
    "st_mtime",
    "st_mtime_ns",
    "st_ctime",
    "getmtime",
    "getctime",
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the contents of an uninterrupted run of two casts."""
    folder = tmp_path_factory.mktemp("whole")
    assert toy_run(folder, toy_experiment())[0] == [*STEPS.values()] * 2
    return contents(folder)


@pytest.mark.parametrize("every", [pytest.param(1, marks=pytest.mark.long), 11])
def test_run_continues_to_the_same_result_after_any_fault(tmp_path, monkeypatch, every):
    """All operations of a cast, or every eleventh, fail in one of four ways."""
    here, struck = toy_experiment(1, mode=Cast(("generate", "execute", "extract"))), []
    toy_run(tmp_path / "whole", here)
    unharmed = contents(tmp_path / "whole")
    for n in range(0, 1000, every):
        kind = list(KINDS)[n // every % len(KINDS)]
        operation = strike(
            monkeypatch.context, n, kind, here, tmp_path / str(n), unharmed
        )
        if operation is None:
            break
        struck.append(operation)
    assert len(struck) > 100 / every
    assert set(struck) == {
        "make_folder",
        "open a file",
        "write",
        "fsync",
        "open",
        "replace",
        "remove",
    }


def test_killed_processes_keep_finished_steps(tmp_path, whole):
    rows = rounds(Forked(toy_experiment(2, pause=0.01)), tmp_path, 5, range(2))
    assert contents(tmp_path / "whole") == whole
    assert sum(row["killed"] for row in rows) >= 3
    assert any(0 < row["steps"] < 8 for row in rows if row["killed"])


def test_only_a_truncated_table_is_made_again(tmp_path, whole):
    here = toy_experiment()
    toy_run(tmp_path / "run", here)
    tables = sorted((tmp_path / "run").glob("iterations/*/*/*.parquet"))
    assert len(tables) == 36
    for file in tables[::9]:
        file.write_bytes(file.read_bytes()[:-9])
        made, said = toy_run(tmp_path / "run", here)
        assert made == [STEPS[file.parent.name]]
        assert file.name in said
        assert contents(tmp_path / "run") == whole


def test_continued_run_never_shows_fewer_trials(tmp_path, whole, monkeypatch):
    """After a kill at any operation, the dataset of a finished run is unchanged."""
    toy_run(tmp_path / "run", toy_experiment())
    for n in range(2, 30, 6):
        with monkeypatch.context() as patch:
            faults = Faults(patch, n, Killed(), True)
            with suppress(Killed):
                toy_run(tmp_path / "run", toy_experiment())
        assert contents(tmp_path / "run") == whole
        if faults.struck is None:
            return
    pytest.fail("going on with a finished run must not write much")


def test_failed_run_states_the_reason_and_has_no_summary(tmp_path):
    """run.json is removed before the first step that it no longer describes."""
    here = toy_experiment()
    toy_run(tmp_path / "run", here)
    (tmp_path / "run" / "iterations/02/estimate/fit.parquet").unlink()

    def broken(*given, **how):
        raise DataError("", "the estimation broke")

    with pytest.raises(DataError, match="broke"):
        toy_run(tmp_path / "run", toy_experiment(estimate_by=broken))
    assert not (tmp_path / "run" / "run.json").exists()
    assert (tmp_path / "run" / "failed.txt").read_text() == "the estimation broke.\n"
    assert toy_run(tmp_path / "run", here)[0] == ["estimate"]
    assert json.loads((tmp_path / "run" / "run.json").read_text())["sentence"]
    assert not (tmp_path / "run" / "failed.txt").exists()


def hold_folder(folder, output):
    """Work in a folder until killed."""
    with run_folder.exclusive_access(folder):
        os.write(output, b"held")
        signal.pause()


@pytest.fixture
def holder(tmp_path):
    """Return a process that works in the folder until it is killed."""
    reader, output = os.pipe()
    process = get_context("fork").Process(target=hold_folder, args=(tmp_path, output))
    process.start()
    assert os.read(reader, 4) == b"held"
    yield process
    process.kill()
    process.join()
    os.close(reader)
    os.close(output)


def test_run_folder_is_locked_only_by_a_living_process(tmp_path, holder):
    with pytest.raises(DataError, match="another process is working in this folder"):
        toy_run(tmp_path, toy_experiment(1))
    assert not (tmp_path / "config.json").exists()
    holder.kill()
    holder.join()
    assert (tmp_path / ".lock").exists()
    assert toy_run(tmp_path, toy_experiment(1))[0] == [*STEPS.values()]


def test_clocks_do_not_change_results(tmp_path, monkeypatch, whole):
    """Every clock reading jumps by years, and every file gets a random time."""
    rng = np.random.default_rng(1)

    class Jumping(datetime):
        @classmethod
        def now(cls, zone):
            return datetime.fromtimestamp(rng.uniform(0, 4e9), UTC)

    monkeypatch.setattr(run_folder, "datetime", Jumping)
    toy_run(tmp_path / "run", toy_experiment())
    for path in (tmp_path / "run").rglob("*"):
        os.utime(path, (rng.uniform(0, 4e9),) * 2)
    assert toy_run(tmp_path / "run", toy_experiment())[0] == []
    assert contents(tmp_path / "run") == whole


def test_only_informative_code_reads_the_wall_clock():
    found = set()
    for room in ("data", "stages", "pipeline"):
        for file in (ROOT / room).rglob("*.py"):
            text = file.read_text()
            # to parse a file takes long
            tree = ast.parse(text if any(clock in text for clock in CLOCKS) else "")
            calls = [n for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
            found |= {
                file.name
                for node in calls
                if node.attr in CLOCKS and ast.unparse(node.value) != "past"
            }
    assert found == {"run_folder.py"}, (
        "only `made at` in a footer may be a time of day; nothing reads it but people"
    )


def refused(folder):
    with run_folder.exclusive_access(folder), run_folder.record_failure(folder):
        run_folder.begin_run(toy_experiment(), folder)
        raise ValueError("refused")


def test_refused_empty_run_removes_its_folder(tmp_path):
    with pytest.raises(ValueError, match="refused"):
        refused(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    (tmp_path / "run").mkdir()
    run_folder.remove_empty_folder(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    toy_run(tmp_path / "run", toy_experiment(1))
    run_folder.remove_empty_folder(tmp_path / "run")
    assert (tmp_path / "run" / "run.json").exists()


@pytest.mark.parametrize("working", [True, False])
def test_refused_run_removes_nothing_of_another(tmp_path, holder, working):
    """The other run works in the folder, or was killed before it made anything."""
    (tmp_path / "config.json").write_text("{}")
    if not working:
        holder.kill()
        holder.join()
    reason = "another process" if working else "other settings"
    with pytest.raises(DataError, match=reason):
        toy_run(tmp_path, toy_experiment(1))
    run_folder.remove_empty_folder(tmp_path)
    left = {file.name for file in tmp_path.iterdir()} - {"failed.txt", "run.log"}
    assert left == {"config.json", ".lock"}
