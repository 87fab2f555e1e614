"""The speed benchmark in small.

Peers are included only if they are installed. Nothing is timed here.
"""

import subprocess

import numpy as np
import pytest

from stringcast.stages.model.engine.simulate import simulate
from tests.benchmarks.speed.bench import (
    ENGINE,
    PEERS,
    main,
    measure_command,
    prepare_engine,
    time_contenders,
)
from tests.benchmarks.speed.cord import TIMES, cord_string, hand_motion


def test_the_engine_is_timed_as_a_caller_uses_it():
    tips = prepare_engine((12, 2e-3), 2)()
    string, values = cord_string(12, 2e-3)
    plain = simulate(string, hand_motion(), values[None], TIMES).tip[0]
    np.testing.assert_array_equal(tips, [plain, plain])
    seconds = time_contenders([ENGINE], 0, rounds=1)
    assert (seconds > 0).all(axis=None)


def test_mujoco_is_read_at_the_frames_time():
    """The tip's lead over the engine's does not depend on the step.

    If the tip were read a step early, the lead would differ by 0.5 ms.
    """
    pytest.importorskip("mujoco", reason="installed by `python3 tasks.py bench`")
    engine = prepare_engine((25, 2e-4), 1)()[0]
    speed = np.gradient(engine, TIMES, axis=0)
    leads = []
    for step in (1e-3, 5e-4):
        tip = PEERS[0].prepare((20, step), 1)()[0]
        leads.append((speed * (tip - engine)).sum() / (speed**2).sum())
    assert abs(leads[0] - leads[1]) < 5e-5


def test_time_and_memory_of_a_whole_process_are_measured():
    parent = np.ones(5 * 10**7)  # the parent's 400 MB do not count
    seconds, megabytes = measure_command("--version")
    assert 0.05 < seconds < 60
    assert 10 < megabytes < parent.nbytes / 1e6
    with pytest.raises(subprocess.CalledProcessError):
        measure_command("no such command")


def test_other_arguments_are_refused():
    with pytest.raises(SystemExit, match="bench diagnosis"):
        main(["faster"])
