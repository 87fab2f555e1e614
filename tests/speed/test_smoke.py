"""The benchmark runs: a smoke size of it, without its peers unless they are installed.
Nothing is timed here.
"""

import subprocess

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from stringcast.stages.model.engine.simulate import simulate
from tests.speed import estimates, measures
from tests.speed.__main__ import printed
from tests.speed.engine import step_loop
from tests.speed.trial import TIMES, engine_tip, hand, string_b
from tests.speed.waits import spent


def test_the_step_loop_alone_moves_the_string_as_simulate_does():
    string, values = string_b(10)
    loop = step_loop(string, hand(), np.tile(values, (16, 1)), TIMES)
    tips = simulate(string, hand(), values[None], TIMES).tip[0]
    out = loop.arguments["out"]
    out[:, 1:] = np.nan
    loop()
    np.testing.assert_allclose(out[0, :, -1], tips, atol=1e-12)
    assert loop.point_steps > 16 * 10 * len(TIMES)


def test_a_table_of_the_smallest_size_is_printed(monkeypatch, capsys):
    monkeypatch.setattr(measures, "BATCHES", (1, 2))
    rows = pd.DataFrame([measures.asdict(row) for row in measures.batches()])
    Console(width=150).print(printed(rows))
    assert "candidates per second" in capsys.readouterr().out


def test_an_estimate_is_judged_by_what_it_predicts():
    """String B from four casts, by the estimate stage; and one of another string is
    told from it.
    """
    found = estimates.row("least_squares", 2)
    assert found["held_out"] < 2e-4
    assert abs(found["above"]) < estimates.NEAR
    assert found["simulations"] < 10_000
    other = estimates.Contender(
        estimates.model(), lambda fitted, given: given.truth * 1.2
    )
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(estimates.CONTENDERS, "other", other)
        wrong = estimates.row("other", 2)
    assert wrong["held_out"] > 2e-4
    assert wrong["above"] > estimates.NEAR
    text = [row.subject for row in estimates.summary(pd.DataFrame([found, wrong]))]
    assert "least_squares: right minimum" in text


def test_mujoco_is_read_at_the_frames_time():
    """How far ahead of the engine's its tip is does not hang on the step: read one
    early, it would be by 0.5 ms.
    """
    pytest.importorskip(
        "mujoco", reason="MuJoCo is installed by `python3 tasks.py bench`"
    )
    from tests.speed.mujoco_chain import Chain

    engine = engine_tip(25, 2e-4)
    speed = np.gradient(engine, TIMES, axis=0)
    tips = [Chain(20, step).rollout(1, 1)[0] for step in (1e-3, 5e-4)]
    one, half = ((speed * (tip - engine)).sum() / (speed**2).sum() for tip in tips)
    assert abs(one - half) < 5e-5


def test_time_and_memory_of_a_whole_process_are_measured():
    held = np.ones(10**8)  # 800 MB here are not the command's
    seconds, megabytes = spent("--help")
    assert 0.05 < seconds < 60
    assert 10 < megabytes < held.nbytes / 1e6
    with pytest.raises(subprocess.CalledProcessError):
        spent("check", "no such folder")
