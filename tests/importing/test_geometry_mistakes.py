"""Each mistake in files is corrected, noted or refused with a clear error.

No wrong data are accepted as usable, and clean files stay unchanged.
"""

import re
import shlex

import numpy as np
import pytest
from conftest import ROOT

from stringcast.data import dataset
from stringcast.stages.check.consistency.record import arm_poses
from stringcast.stages.model.interpolation import interpolate_rows
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
# The other cases are marked long. The sample needs no fit of clocks, which is slow.
QUICK = {
    "simulated": ("missing y of the tip", "trackers shuffled"),
    "sample": (
        "clean",
        "trackers shuffled",
        "joints 1 and 2 swapped",
        "radians named degrees",
        "length 20 % too long",
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
MAX_ERROR_M = 0.02  # a fitted base has an error, too
# tolerated error of fitted clocks; the study of clocks measures it
CLOCK_ERRORS_S = np.arange(-20, 21) * 1e-3
SHARE_TRUE = 0.9  # the other points may be outliers


def cases():
    for bench in BENCHES:
        for points in ("one", "two"):
            for mistake in ALL_MISTAKES:
                if points == "one" and mistake in NEEDS_TWO_POINTS:
                    continue
                is_quick = points == "two" and mistake in QUICK.get(bench, ())
                marks = [] if is_quick else [pytest.mark.long]
                if bench == "two_clocks" and not TWO_CLOCKS.exists():
                    marks.append(
                        pytest.mark.skip(reason="needs shared/cases/two_clocks")
                    )
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
def test_mistakes_are_corrected_or_refused_with_a_clear_error(
    benches, called, tmp_path, undrawn_trial, name, points, mistake
):
    truth = benches(name, points)
    if mistake.startswith("fps"):
        truth = truth.with_rate(1.0)  # frames at equal intervals
    make, answer = ALL_MISTAKES[mistake]
    words = make(truth).write(tmp_path)
    result = called("import", *words, "--to", tmp_path / "mine")
    text = re.sub(r"\s+", " ", result.stdout + result.stderr)
    print(f"{name} | {points} | {mistake} | {summary_of(result)}")
    assert "Traceback" not in text
    assert re.search(answer, text), text[-1500:]
    # the proposed command must give the true data
    command = re.search(r"If that is so: (.*)", result.stderr)
    if command:
        proposed = shlex.split(command[1])
        result = called(*proposed[proposed.index("import") :])
        assert result.returncode == 0, result.stdout[-1500:] + result.stderr
    if result.returncode == 0:
        assert is_true(tmp_path / "mine", truth)


def summary_of(result):
    """Summarise the output in a line."""
    if result.returncode == 0:
        corrections = re.findall(r"Taken as ([^\n]*)\.\n", result.stdout)
        corrections = [words for words in corrections if "clock" not in words]
        return "taken as " + " ".join(corrections) if corrections else "left alone"
    return re.sub(r"\s+", " ", result.stderr)[-420:]


def is_true(folder, bench):
    """Return whether all trials of a dataset agree with the true bench.

    The dataset may have fewer trials than the bench.
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
        # the arm's clock may have another origin
        begin = trial.arm["t"].iloc[0] - t[0]
        if not is_near(trial.arm["t"] - begin, hand, t, true_hand):
            return False
        for name, (point_t, xy) in bench.points[number - 1].items():
            s = trial.points["s"].max() if name == "tip" else trial.points["s"].min()
            point = trial.points[np.isclose(trial.points["s"], s)]
            times = point["t"] - begin - bench.clock
            if not is_near(times, point[["x", "y"]].to_numpy(), point_t, xy):
                return False
    return True


def is_near(times, positions, true_times, true_positions):
    """Return whether most positions (N, 2) are true, apart from a clock error."""
    smallest = np.inf
    for offset in CLOCK_ERRORS_S:
        at_times = interpolate_rows(times + offset, true_times, true_positions)
        errors = np.linalg.norm(positions - at_times, axis=1)
        smallest = min(smallest, np.quantile(errors, SHARE_TRUE))
    return smallest < MAX_ERROR_M
