"""The ledger and its launchers, with quick fake jobs."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
import pytest

from stringcast.data.schema import DataError
from stringcast.pipeline.sweep import launchers
from stringcast.pipeline.sweep.attempt import Attempt, error_message, job_ending
from stringcast.pipeline.sweep.finish import finish
from stringcast.pipeline.sweep.launcher import LedgerLauncher
from stringcast.pipeline.sweep.ledger import (
    DONE_STATE,
    FAILED_STATE,
    LOST_WORKER_ERROR,
    PENDING_STATE,
    RUNNING_STATE,
    Job,
    Ledger,
)

STAND_IN = '''
"""What a job does, by its seed: 2 fails, 3 is killed, 4 waits to be told; the others leave a file."""
import os, pathlib, re, sys, time
given = dict(a.lstrip("+").split("=", 1) for a in sys.argv[1:])
place = pathlib.Path(re.fullmatch("'(.*)'", given["hydra.run.dir"])[1])
place.mkdir(parents=True, exist_ok=True)
with (place / "begun").open("a") as file:
    file.write("x")
if given["seed"] == "2" and not (place.parents[0] / "mended").exists():
    print("Error: the string is\\ntoo short", file=sys.stderr)
    sys.exit(1)
if given["seed"] == "3":
    os.kill(os.getpid(), 9)
while given["seed"] == "4" and not (place.parents[0] / "told").exists():
    time.sleep(0.01)
(place / "out").write_text(os.environ["NUMBA_NUM_THREADS"])
'''


@pytest.fixture
def stand_in(tmp_path):
    """Return the command of a job."""
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    return (sys.executable, "-S", str(script))


def ledger_of_seeds(folder, *seeds):
    """Return a ledger with a job for each seed, and the keys."""
    ledger = Ledger(folder)
    jobs = [
        Job(seed, (f"seed={seed}",), {"seed": seed, "name": "stand_in"})
        for seed in seeds
    ]
    for job in jobs:
        ledger.add(job)
    return ledger, [job.key for job in jobs]


def states(ledger):
    return {job.number: job.state for job in ledger.jobs()}


def begun(ledger, key):
    file = ledger.job_folder(key) / "begun"
    return len(file.read_text()) if file.exists() else 0


LAUNCHERS = {
    "serial": ("pipeline", {}),
    "joblib": ("joblib", {"workers": 3}),
    "slurm": ("submitit", {"cluster": "local", "parameters": {"timeout_min": 5}}),
    "ray": ("ray", {"resources": {}}),
}


@pytest.fixture
def cluster():
    """Start a local Ray cluster of two nodes with two cores; return its address."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    machines = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False}
    )
    machines.add_node(num_cpus=2)
    yield machines.address
    machines.shutdown()


@pytest.mark.parametrize("name", LAUNCHERS)
def test_all_launchers_end_all_jobs_despite_failures(name, tmp_path, stand_in, request):
    package, settings = LAUNCHERS[name]
    pytest.importorskip(package)
    if name == "ray":
        settings = settings | {"address": request.getfixturevalue("cluster")}
    ledger, keys = ledger_of_seeds(tmp_path / "sweep", 0, 2, 3)
    launch = getattr(launchers, name)
    ended_keys = list(
        launch(
            [Attempt(ledger.folder, key, stand_in) for key in keys],
            threads=2,
            **settings,
        )
    )
    assert sorted(ended_keys) == sorted(keys)
    assert states(ledger) == {
        0: DONE_STATE,
        2: FAILED_STATE,
        3: FAILED_STATE,
    }
    failed = {
        job.number: job.error for job in ledger.jobs() if job.state == FAILED_STATE
    }
    assert failed[2] == "the string is\ntoo short"
    assert "SIGKILL" in failed[3]
    assert {
        (ledger.job_folder(key) / "out").read_text()
        for key in keys
        if (ledger.job_folder(key) / "out").exists()
    } == {"2"}
    assert all(
        job.attempts == 1 and job.seconds > 0 and job.host for job in ledger.jobs()
    )


def test_missing_jobs_run_again_and_failed_ones_on_request(tmp_path, stand_in):
    ledger, keys = ledger_of_seeds(tmp_path / "sweep", 0, 1, 2)
    for key in keys[1:]:
        Attempt(ledger.folder, key, stand_in)(1)
    assert states(ledger) == {0: PENDING_STATE, 1: DONE_STATE, 2: FAILED_STATE}
    ledger_of_seeds(tmp_path / "sweep", 0, 1, 2)  # a repeated request keeps the states
    assert ledger.reset_unfinished(keys, ()) == [keys[0]]
    for key in keys:
        Attempt(ledger.folder, key, stand_in)(1)
    assert [begun(ledger, key) for key in keys] == [1, 1, 1]
    (ledger.folder / "mended").touch()
    assert ledger.reset_unfinished(keys, (FAILED_STATE,)) == [keys[2]]
    Attempt(ledger.folder, keys[2], stand_in)(1)
    mended = ledger.read(keys[2])
    assert (mended.state, mended.error, mended.attempts) == (DONE_STATE, "", 2)


def test_job_key_depends_on_settings_not_on_spelling():
    one = Job(0, ("a=1", "b=2"), {"a": 1, "b": 2})
    assert (
        one.key
        == Job(7, ("b=2", "a=1"), {"b": 2, "a": 1}, state=FAILED_STATE, attempts=3).key
    )
    assert one.key != Job(0, ("a=1", "b=2"), {"a": 1, "b": 3}).key


def attempt(folder, key, command):
    Attempt(folder, key, command)(1)


def until(true, limit=20.0):
    """Wait until a condition holds."""
    end = time.monotonic() + limit
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def begin(ledger, key, command):
    """Start an attempt in its own process, and wait until its job runs."""
    process = get_context("fork").Process(
        target=attempt, args=(ledger.folder, key, command)
    )
    process.start()
    until(lambda: begun(ledger, key))
    return process


def working(script):
    """Return process ids of the fake jobs."""
    found = subprocess.run(
        ["pgrep", "-f", str(script)], capture_output=True, text=True, check=False
    ).stdout
    return [int(number) for number in found.split()]


def test_job_of_a_killed_worker_stays_claimed_until_it_ends(tmp_path, stand_in):
    """Otherwise a second attempt would write into the folder of the first."""
    ledger, (key,) = ledger_of_seeds(tmp_path / "sweep", 4)
    worker = begin(ledger, key, stand_in)
    os.kill(worker.pid, signal.SIGKILL)
    worker.join()
    assert ledger.reset_unfinished([key], ()) == []
    Attempt(ledger.folder, key, stand_in)(1)
    ledger.mark_lost_as_failed([key])
    assert (states(ledger), begun(ledger, key)) == ({4: RUNNING_STATE}, 1)
    for number in working(stand_in[-1]):
        os.kill(number, signal.SIGKILL)
    until(lambda: ledger.reset_unfinished([key], ()) == [key])


def test_lost_worker_counts_as_failure(tmp_path, stand_in):
    ledger, (key,) = ledger_of_seeds(tmp_path / "sweep", 0)
    with ledger.claim(key) as log:
        assert log is not None
        ledger.write(replace(ledger.read(key), state=RUNNING_STATE, attempts=1))
        ledger.mark_lost_as_failed([key])
        assert states(ledger) == {0: RUNNING_STATE}
    ledger.mark_lost_as_failed([key])
    assert (ledger.read(key).state, ledger.read(key).error) == (
        FAILED_STATE,
        LOST_WORKER_ERROR,
    )


def test_setting_named_like_an_outcome_gets_its_own_column(tmp_path, stand_in):
    ledger = Ledger(tmp_path)
    for many in (1, 2):
        ledger.add(
            Job(
                many,
                (f"max_casts={many}",),
                {"max_casts": many, "name": "x", "seed": 0},
            )
        )
    finish(tmp_path)
    table = pd.read_parquet(tmp_path / "sweep.parquet")
    assert list(table["max_casts"]) == [1, 2]
    assert table["casts"].isna().all()  # no job has made a cast


def test_two_sweeps_in_one_folder_run_each_job_once(tmp_path, stand_in):
    ledger, keys = ledger_of_seeds(tmp_path / "sweep", *range(5, 25))
    context = get_context("fork")
    sides = [
        context.Process(target=every, args=(ledger.folder, order, stand_in))
        for order in (keys, keys[::-1], keys)
    ]
    for side in sides:
        side.start()
    for side in sides:
        side.join()
    assert set(states(ledger).values()) == {DONE_STATE}
    assert {begun(ledger, key) for key in keys} == {1}


def every(folder, keys, command):
    """Attempt all waiting jobs, like a sweep."""
    for key in Ledger(folder).reset_unfinished(keys, ()):
        attempt(folder, key, command)


def whole_sweep(folder, keys, command, said):
    """Run a sweep in this process, and make its table and page.

    said: file for the output.
    """
    every(folder, keys, command)
    sweep = LedgerLauncher("", "", retry=False, warm_up_jobs=0)
    sweep.launched = folder, finish
    with said.open("w") as sys.stderr:
        os._exit(sweep.finish_sweep())


def test_two_sweeps_in_one_folder_end_with_complete_tables(tmp_path, stand_in):
    """The second starts during a job of the first, and ends earlier."""
    ledger, keys = ledger_of_seeds(tmp_path / "sweep", 4, 5, 6)
    first, second = (
        get_context("fork").Process(
            target=whole_sweep, args=(ledger.folder, order, stand_in, tmp_path / name)
        )
        for name, order in (("first", keys), ("second", keys[::-1]))
    )
    first.start()
    until(lambda: begun(ledger, keys[0]))
    second.start()
    second.join()
    assert second.exitcode == 1
    said = (tmp_path / "second").read_text()
    assert (
        "2 of 3 job(s) of the sweep are done.\n1 are run by another process, which completes the table"
        in said
    )
    assert "did not end" not in said
    (ledger.folder / "told").touch()
    first.join()
    assert first.exitcode == 0
    assert (
        (tmp_path / "first")
        .read_text()
        .startswith("3 of 3 job(s) of the sweep are done.")
    )
    assert [begun(ledger, key) for key in keys] == [1, 1, 1]
    assert (
        list(pd.read_parquet(ledger.folder / "sweep.parquet")["state"])
        == [DONE_STATE] * 3
    )


def test_randomly_killed_sweep_loses_nothing(tmp_path, stand_in):
    """A sweep of 24 jobs is killed with SIGKILL up to 25 times, each within 0.06 s."""
    ledger, keys = ledger_of_seeds(tmp_path / "sweep", *range(5, 29))
    kills = 0
    while kills < 25 and set(states(ledger).values()) != {DONE_STATE}:
        side = get_context("fork").Process(
            target=every, args=(ledger.folder, keys, stand_in)
        )
        side.start()
        side.join(0.02 + 0.02 * (kills % 3))
        kills += side.is_alive()
        side.kill()
        side.join()
        assert len(ledger.jobs()) == 24  # each entry exists and is whole
    assert kills > 3
    until(
        lambda: (
            every(ledger.folder, keys, stand_in)
            or set(states(ledger).values()) == {DONE_STATE}
        )
    )
    assert all(1 <= begun(ledger, key) <= ledger.read(key).attempts for key in keys)


def test_damaged_ledger_entry_is_named(tmp_path):
    ledger, (key,) = ledger_of_seeds(tmp_path, 0)
    file = tmp_path / "ledger" / f"{key}.json"
    file.write_text(json.dumps({"number": 1}))
    with pytest.raises(DataError, match=f"{key}.json: not a job.*Delete it"):
        ledger.jobs()


@pytest.mark.parametrize(
    ("said", "error"),
    [
        (
            "step ----- 0:01\nError: target.x = 3: too far\n  choose another\n\n",
            "target.x = 3: too far\n  choose another",
        ),
        (
            "Traceback (most recent call last):\n  File ...\nValueError: Error: no\n",
            "ValueError: Error: no",
        ),
        ("", ""),
    ],
)
def test_error_is_the_last_message_of_the_job(said, error):
    assert error_message(said) == error


def test_interrupted_job_is_not_a_failure():
    assert job_ending(130, "Interrupted.") == (PENDING_STATE, "")
    assert job_ending(-signal.SIGINT, "") == (PENDING_STATE, "")
    assert job_ending(1, "") == (FAILED_STATE, "It ended with exit status 1.")


def test_unwritable_folder_gives_one_clear_error():
    with pytest.raises(DataError, match=r"/proc/.*hydra.sweep.dir"):
        ledger_of_seeds(Path("/proc/nope"), 0)
