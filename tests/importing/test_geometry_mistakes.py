"""Mistakes in files end in the right correction, a note or a clear error.

Nothing wrong is called usable, and clean files are left alone.
"""

import re
import shlex

import numpy as np
import pytest
from conftest import ROOT

from stringcast.data import dataset
from stringcast.stages.check.consistency.record import arm_poses
from stringcast.stages.common import interpolate_rows
from tests.importing.mistakes import (
    FILE_MISTAKES,
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
ALL_MISTAKES = MISTAKES | FILE_MISTAKES
# Single corrections have quick tests of their own, and the others here are long. The
# clocks of the sample are together, so that they need no fit of seconds.
QUICK = {
    "simulated": ("missing y of the tip", "trackers shuffled"),
    "sample": (
        "clean",
        "trackers shuffled",
        "joints 1 and 2 swapped",
        "cm named mm",
        "tracker's stamps doubled",
        "robot's stamps turn back",
        "epoch ns named s",
        "epoch float32",
        "ms named s",
        "tip hidden half of the time",
        "one frame",
        "one frame in one trial",
        "empty file",
        "heading alone",
        "joints called alpha",
        "angle wraps at 180 degrees",
        "one joint in counts",
        "decimal comma",
    ),
}
MAX_ERROR_M = 0.02  # of a fitted base
# of clocks that are aligned: how far intervals are right, the study of clocks says
CLOCK_ERRORS_S = np.arange(-20, 21) * 1e-3
SHARE_TRUE = 0.9  # of the points: others may be outliers


def cases():
    for bench in BENCHES:
        for points in ("one", "two"):
            for mistake in ALL_MISTAKES:
                if points == "one" and mistake in NEEDS_TWO_POINTS:
                    continue
                is_quick = points == "two" and mistake in QUICK.get(bench, ())
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
    benches, called, tmp_path, undrawn_trial, name, points, mistake
):
    truth = benches(name, points)
    if mistake.startswith("fps"):
        truth = truth.with_rate(1.0)  # whose frames are even
    make, answer = ALL_MISTAKES[mistake]
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
    """Return whether the trials of a dataset hold what is true of a bench.

    Trials are those of the bench, of which some may be left out.
    """
    data = dataset.read_dataset(folder)
    arm = data.metadata["arm"]
    for number, (t, joints) in enumerate(bench.hands, 1):
        trial = data.trials.get("t00" if len(bench.hands) == 1 else f"t{number}")
        if trial is None:
            continue
        read = trial.arm[["q1", "q2", "q3"]].to_numpy()
        hand = arm_poses(read, arm["links"], arm["base"])[:, :2]
        true_hand = arm_poses(joints, bench.links, bench.base)[:, :2]
        # the arm's clock may count from elsewhere
        begin = trial.arm["t"].iloc[0] - t[0]
        if not is_near(trial.arm["t"] - begin, hand, t, true_hand):
            return False
        for name, (point_t, xy) in bench.points[number - 1].items():
            s = trial.points["s"].max() if name == "tip" else trial.points["s"].min()
            own = trial.points[np.isclose(trial.points["s"], s)]
            times = own["t"] - begin - bench.clock
            if not is_near(times, own[["x", "y"]].to_numpy(), point_t, xy):
                return False
    return True


def is_near(times, places, true_times, true_places):
    """Return whether most places (N, 2) are the true ones at their times."""
    smallest = np.inf
    for offset in CLOCK_ERRORS_S:
        at_times = interpolate_rows(times + offset, true_times, true_places)
        errors = np.linalg.norm(places - at_times, axis=1)
        smallest = min(smallest, np.quantile(errors, SHARE_TRUE))
    return smallest < MAX_ERROR_M
