"""Mistakes of geometry end in the right correction or a clear error.

Nothing wrong is called usable, and clean files are left alone.
"""

import re
import shlex

import numpy as np
import pytest
from conftest import ROOT

from stringcast.data import dataset
from stringcast.stages.check.consistency.record import arm_poses
from tests.importing.mistakes import (
    MISTAKES,
    NEEDS_TWO_POINTS,
    sample_bench,
    simulated_bench,
    two_clocks_bench,
)

TWO_CLOCKS = ROOT.parent / "shared" / "cases" / "two_clocks"
BENCHES = {
    "simulated": simulated_bench,
    "sample": lambda: sample_bench(ROOT / "data" / "sample"),
    "two_clocks": lambda: two_clocks_bench(TWO_CLOCKS),
}
# single corrections have quick tests of their own; the others here are long
QUICK = {"clean", "missing y of the tip", "trackers shuffled"}
MAX_ERROR_M = 0.02  # of a fitted base, and of clocks that are aligned


def cases():
    for bench in BENCHES:
        for points in ("one", "two"):
            for mistake in MISTAKES:
                if points == "one" and mistake in NEEDS_TWO_POINTS:
                    continue
                is_quick = (bench, points) == ("simulated", "two") and mistake in QUICK
                marks = [] if is_quick else [pytest.mark.long]
                if bench == "two_clocks" and not TWO_CLOCKS.exists():
                    marks.append(pytest.mark.skip(reason="the case is not here"))
                yield pytest.param(bench, points, mistake, marks=marks)


@pytest.fixture(scope="module")
def benches():
    made = {}

    def bench(name, points):
        if name not in made:
            made[name] = BENCHES[name]()
        return made[name].with_tip_alone() if points == "one" else made[name]

    return bench


@pytest.mark.parametrize(("name", "points", "mistake"), list(cases()))
def test_a_mistake_ends_in_its_correction_or_a_clear_error(
    benches, called, tmp_path, monkeypatch, name, points, mistake
):
    # drawing takes most of the time
    monkeypatch.setattr(
        "stringcast.pipeline.commands.import_.draw_first_trial", lambda *_: None
    )
    truth = benches(name, points)
    if mistake.startswith("fps"):
        truth = truth.with_rate(1.0)  # whose frames are even
    make, answer = MISTAKES[mistake]
    words = make(truth).write(tmp_path)
    done = called("import", *words, "--to", tmp_path / "mine")
    text = re.sub(r"\s+", " ", done.stdout + done.stderr)
    print(f"{name} | {points} | {mistake} | {summary_of(done)}")
    assert "Traceback" not in text
    assert re.search(answer, text), text[-1500:]
    # a command that is proposed is the right one
    command = re.search(r"If that is so: (.*)", done.stderr)
    if command:
        proposed = shlex.split(command[1])
        done = called(*proposed[proposed.index("import") :])
        assert done.returncode == 0, done.stdout[-1500:] + done.stderr
    if done.returncode == 0:
        assert is_true(tmp_path / "mine", truth)


def summary_of(done):
    """Return the answer in a line."""
    if done.returncode == 0:
        taken = re.findall(r"Taken as ([^\n]*)\.\n", done.stdout)
        taken = [words for words in taken if "clock" not in words]
        return "taken as " + " ".join(taken) if taken else "left alone"
    return re.sub(r"\s+", " ", done.stderr)[-420:]


def is_true(folder, bench):
    """Return whether a dataset holds what is true of a bench."""
    data = dataset.read_dataset(folder)
    arm = data.metadata["arm"]
    for (_, joints), points, trial in zip(
        bench.hands, bench.points, data.trials.values(), strict=False
    ):
        read = trial.arm[["q1", "q2", "q3"]].to_numpy()
        hand = arm_poses(read, arm["links"], arm["base"])[:, :2]
        true = arm_poses(joints, bench.links, bench.base)[:, :2]
        for point, (_, xy) in points.items():
            s = trial.points["s"].max() if point == "tip" else trial.points["s"].min()
            own = trial.points[np.isclose(trial.points["s"], s)][["x", "y"]].to_numpy()
            if len(own) != len(xy) or np.abs(own - xy).max() > MAX_ERROR_M:
                return False
        if np.abs(hand - true).max() > MAX_ERROR_M:
            return False
    return True
