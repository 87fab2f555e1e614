"""Datasets with each kind of mistake.

Each mistake gives the right finding, which names file, field and remedy. Clean datasets
give none.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT, measured_sample

from stringcast.data import dataset
from stringcast.data.schema import DataError
from stringcast.pipeline.commands import check_effects
from stringcast.pipeline.commands.check import read_measurements
from stringcast.stages.check.check import collect_findings, refuse_errors
from stringcast.stages.check.clocks import check_bandwidth
from stringcast.stages.check.finding import Severity
from stringcast.stages.check.frames import check_camera_view
from stringcast.stages.check.gravity import estimate_gravity
from stringcast.stages.check.overview import dataset_overview
from stringcast.stages.common import GRAVITY_M_S2
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.lens import Lens

SAMPLE = ROOT / "data" / "sample"
MEASURED = ROOT.parent / "shared" / "measured"
ANGLES = ["q1", "q2", "q3"]
# trials that a model explains so well that right data need no search for mistakes
TRIALS = ["t00", "t02", "t03"]
AS_A_RUN = measured_sample()


class Dirty:
    """Tables of the sample that are changed and written."""

    def __init__(self):
        arm, points = (
            pd.read_parquet(SAMPLE / f"{name}.parquet") for name in ("arm", "points")
        )
        # a third of the points and three trials make the test faster
        few = np.sort(points["s"].unique())[::3]
        self.arm = arm[arm["trial"].isin(TRIALS)].reset_index(drop=True)
        self.points = points[
            points["trial"].isin(TRIALS) & points["s"].isin([*few, points["s"].max()])
        ]
        self.points = self.points.reset_index(drop=True)
        self.about = yaml.safe_load((SAMPLE / "dataset.yaml").read_text())
        self.grasp = None
        self.both = False

    @property
    def length(self):
        return self.about["string"]["length"]

    def with_poses(self):
        """Replace joint angles by poses of the grasp."""
        pose = AS_A_RUN.arm.grasp_pose(self.arm[ANGLES].to_numpy())
        self.grasp = self.arm[["trial", "t"]].assign(
            x=pose[:, 0], y=pose[:, 1], theta=pose[:, 2]
        )
        return self

    def write(self, folder):
        hand = {"arm": self.arm} if self.grasp is None or self.both else {}
        hand |= {} if self.grasp is None else {"grasp": self.grasp}
        for name, table in {**hand, "points": self.points}.items():
            table.to_csv(folder / f"{name}.csv", index=False)
        (folder / "dataset.yaml").write_text(yaml.safe_dump(self.about))
        return folder


@pytest.fixture
def dirty():
    return Dirty()


def read_checked(folder):
    """Read data as the command does, without composing the configuration again."""
    data = dataset.read_dataset(folder)
    links = data.metadata.get("arm", {}).get("links", AS_A_RUN.arm.links)
    length = data.metadata.get("string", {}).get("length", 0.3)
    return replace(
        AS_A_RUN,
        data=data,
        arm=replace(AS_A_RUN.arm, links=tuple(links)),
        length=length,
    )


def findings_in(folder):
    return collect_findings(read_checked(folder))


def scaled(name, columns, factor):
    def spoil(dirty):
        getattr(dirty, name)[columns] *= factor

    return spoil


def length(factor):
    def spoil(dirty):
        dirty.about["string"]["length"] *= factor

    return spoil


def from_the_tip(dirty):
    dirty.points["s"] = dirty.length - dirty.points["s"]


def in_pixels(dirty):
    camera = AS_A_RUN.camera
    dirty.points[["x", "y"]] = camera.pixels(dirty.points[["x", "y"]].to_numpy())


def exchange_axes(dirty):
    dirty.points[["x", "y"]] = dirty.points[["y", "x"]].to_numpy()


def other_origin(dirty):
    dirty.points["x"] += 0.5


def links(dirty):
    dirty.about["arm"]["links"] = [250, 200, 135]


def everything(dirty):
    dirty.with_poses()
    for table in ("grasp", "points"):
        getattr(dirty, table)[["x", "y"]] *= 1e3
    dirty.points["s"] *= 1e3
    dirty.about["string"]["length"] *= 1e3


def mm_and_down(dirty):
    dirty.points[["x", "y"]] *= 1e3
    dirty.points["y"] *= -1


def five_frames(dirty):
    dirty.points = dirty.points[
        dirty.points.groupby("trial")["t"].rank("dense") % 40 == 1
    ]


def nine_lost(dirty):
    dirty.points.loc[dirty.points.sample(frac=0.9, random_state=1).index, "x"] = np.nan


def arm_and_grasp(dirty):
    dirty.with_poses().both = True


def unknown_arm(dirty):
    undescribed(dirty)
    dirty.points["x"] -= 0.3  # angles of an arm at another place


def undescribed(dirty):
    """Remove the description of the configured arm."""
    del dirty.about["arm"]


def somewhere(dirty):
    del dirty.about["arm"]["base"]


def none_left(dirty):
    dirty.points["valid"] = False


def poses(dirty):
    scaled("grasp", ["x", "y"], 1e3)(dirty.with_poses())


def degrees_of_poses(dirty):
    dirty.with_poses().grasp["theta"] *= 180 / np.pi


def degrees(dirty):
    # in degrees, samples of the fastest trial would be spikes, too
    dirty.arm = dirty.arm[dirty.arm["trial"] != "t02"].copy()
    dirty.points = dirty.points[dirty.points["trial"] != "t02"]
    dirty.arm[ANGLES] *= 180 / np.pi


def sigma_in_mm(dirty):
    dirty.about["noise"] = {"point_sigma": 0.7}


CERTAIN = {
    "points in mm": (
        scaled("points", ["x", "y"], 1e3),
        "points.csv x, y",
        "Multiply x and y by 0.001",
    ),
    "points in cm": (
        scaled("points", ["x", "y"], 1e2),
        "points.csv x, y",
        "Multiply x and y by 0.01",
    ),
    "points in px": (in_pixels, "points.csv x, y", "camera.px_per_m"),
    "s in mm": (scaled("points", ["s"], 1e3), "points.csv s", "Multiply s by 0.001"),
    "s, x, y in mm": (
        scaled("points", ["s", "x", "y"], 1e3),
        "points.csv s, x, y",
        "Multiply s, x and y by 0.001",
    ),
    "length in mm": (length(1e3), "dataset.yaml string.length", "Multiply it by 0.001"),
    "length in cm": (length(1e2), "dataset.yaml string.length", "Multiply it by 0.01"),
    "links in mm": (links, "dataset.yaml arm.links", "Multiply them by 0.001"),
    "poses in mm": (poses, "grasp.csv x, y", "Multiply x and y by 0.001"),
    "all in mm": (
        everything,
        "points.csv s, x, y",
        "Multiply all of them, and arm.links and arm.base, by 0.001",
    ),
    "mm and y down": (
        mm_and_down,
        "points.csv x, y; points.csv y",
        "Multiply x and y by 0.001",
    ),
    "five frames a second": (five_frames, "points.csv t", "Film faster"),
    "nine of ten lost": (nine_lost, "points.csv x", "Correct them"),
    "arm and grasp": (
        arm_and_grasp,
        "arm.csv, grasp.csv q1, q2, q3, x, y, theta",
        "take the other away: rm ",
    ),
    "unknown arm": (
        unknown_arm,
        "dataset.yaml arm.links, arm.base",
        "printf '\\narm: {links: [0.25, 0.2, 0.135], base",
    ),
    "undescribed arm": (
        undescribed,
        "dataset.yaml arm.links, arm.base",
        "printf '\\narm: {links: [0.25, 0.2, 0.135], base",
    ),
    "arm anywhere": (somewhere, "dataset.yaml arm.base", "base: [0.2, 0.2]"),
    "no trial left": (none_left, "points.csv valid", "a blank is false"),
    "shorter string": (length(0.8), "points.csv s, x, y", "Correct string.length"),
    "degrees": (
        degrees,
        "arm.csv q1, q2, q3",
        "Multiply them by pi / 180",
    ),
    "theta in degrees": (
        degrees_of_poses,
        "grasp.csv theta",
        "Multiply them by pi / 180",
    ),
    "y down": (scaled("points", ["y"], -1), "points.csv y", "Multiply y by -1"),
    "x to the left": (scaled("points", ["x"], -1), "points.csv x", "Multiply x by -1"),
    "x for y": (exchange_axes, "points.csv x, y", "Exchange the two columns"),
    "s from the tip": (from_the_tip, "points.csv s", "Replace s by string.length - s"),
    "other origin": (
        other_origin,
        "dataset.yaml arm.base",
        "Measure where joint 1 sits",
    ),
    "camera in ms": (
        scaled("points", ["t"], 1e3),
        "points.csv t",
        "Multiply t by 0.001",
    ),
    "arm in ms": (scaled("arm", ["t"], 1e3), "arm.csv t", "Multiply t by 0.001"),
    "sigma in mm": (
        sigma_in_mm,
        "dataset.yaml noise.point_sigma",
        "Multiply it by 0.001",
    ),
}


@pytest.mark.parametrize("kind", CERTAIN)
def test_an_error_has_a_remedy_and_stops_runs(dirty, tmp_path, kind):
    spoil, place, remedy = CERTAIN[kind]
    spoil(dirty)
    here = read_checked(dirty.write(tmp_path))
    findings = collect_findings(here)
    assert all(f.file and f.field and f.statement and f.remedy for f in findings)
    errors = [f for f in findings if f.severity is Severity.ERROR]
    assert {f"{f.file} {f.field}" for f in errors} == {*place.split("; ")}, [
        f.sentence for f in errors
    ]
    assert remedy in errors[0].remedy
    # too little data give no advice on clocks or noise
    assert len(findings) == 1 or kind not in TOO_LITTLE
    assert not dataset_overview(here)["usable"]
    with pytest.raises(DataError) as refused:
        refuse_errors(here)
    assert any(one.strip() in str(refused.value) for one in place.split("; "))
    assert remedy in str(refused.value)
    assert "python -m pipeline check" in str(refused.value)


TOO_LITTLE = ("five frames a second", "nine of ten lost")
AT_THE_TIP = (
    "points in mm",
    "points in px",
    "s in mm",
    "length in mm",
    "links in mm",
    "poses in mm",
    "degrees",
)


@pytest.mark.parametrize("kind", AT_THE_TIP)
def test_an_error_is_found_from_tips_alone(dirty, tmp_path, kind):
    """The tip alone suffices to refuse the dataset.

    Another mistake may explain it, too, but the presence of a mistake is certain.
    """
    spoil, _, _ = CERTAIN[kind]
    dirty.points = dirty.points[dirty.points["s"] > 0.99 * dirty.length].reset_index(
        drop=True
    )
    spoil(dirty)
    assert any(f.severity is Severity.ERROR for f in findings_in(dirty.write(tmp_path)))


def offset(seconds):
    def spoil(dirty):
        dirty.points["t"] += seconds

    return spoil


def frozen(dirty):
    rows = dirty.arm.index[dirty.arm["trial"] == "t00"]
    dirty.arm.loc[rows[20:60], "q2"] = dirty.arm.loc[rows[20], "q2"]


def let_go(dirty):
    for name in ANGLES:
        dirty.arm[name] = dirty.arm.groupby("trial")[name].transform("first")


def held(dirty):
    number = dirty.points.groupby("trial")["t"].rank("dense").astype(int)
    for column in ("x", "y"):
        again = dirty.points.groupby(["trial", "s"])[column].shift(1)
        dirty.points[column] = again.where(
            (number % 4 == 0) & again.notna(), dirty.points[column]
        )


def many_lost(dirty):
    dirty.points.loc[dirty.points.sample(frac=0.2, random_state=1).index, "x"] = np.nan


def hole_in_the_log(dirty):
    rows = dirty.arm.index[dirty.arm["trial"] == "t00"]
    dirty.arm = dirty.arm.drop(index=rows[50:75])


def about(**blocks):
    def spoil(dirty):
        dirty.about |= blocks

    return spoil


def without(table, trial):
    def spoil(dirty):
        frame = getattr(dirty, table)
        setattr(dirty, table, frame[frame["trial"] != trial])

    return spoil


def one_trial(dirty):
    for table in ("arm", "points"):
        frame = getattr(dirty, table)
        setattr(dirty, table, frame[frame["trial"] == "t00"])


def no_length(dirty):
    del dirty.about["string"]


def misspelt(dirty):
    dirty.about["strin"] = dirty.about.pop("string")


def named_sigma(dirty):
    dirty.about.pop("noise", None)
    dirty.points["Sigma"] = 1e-3


def none_valid(dirty):
    dirty.points["valid"] = dirty.points["trial"] != "t03"


def two_frames(dirty):
    late = dirty.points.groupby("trial")["t"].rank("dense") > 2
    dirty.points = dirty.points[(dirty.points["trial"] != "t03") | ~late]


def beyond(dirty):
    """Enlarge the arc lengths of one trial after its beginning."""
    late = (dirty.points["trial"] == "t03") & (
        dirty.points["t"] > dirty.points["t"].min() + 0.3
    )
    dirty.points.loc[late, "s"] *= 1.2


SUSPICIOUS = {
    "camera early": (offset(-0.3), "points.csv t", "add it to"),
    "camera late": (offset(0.4), "points.csv t", "subtract it from"),
    "hardly overlap": (offset(0.45), "points.csv t", "both clocks begin together"),
    "frozen joint": (frozen, "arm.csv q2", "its log is frozen"),
    "let go": (let_go, "points.csv t", "initial: moving"),
    "held points": (held, "points.csv x, y", "'valid' to false"),
    "lost points": (many_lost, "points.csv x", "Correct them"),
    "hole in the log": (hole_in_the_log, "arm.csv t", "leave the trial out"),
    "only in arm": (
        without("points", "t03"),
        "points.csv trial",
        "Add its rows to points",
    ),
    "only in points": (
        without("arm", "t03"),
        "arm.csv trial",
        "Add its rows to the arm's",
    ),
    "one trial": (one_trial, "arm.csv trial", "Record two more"),
    "no length": (no_length, "dataset.yaml string.length", "grasp to tip"),
    "other fps": (about(camera={"fps": 204}), "points.csv t", "as filmed"),
    "noise too small": (
        about(noise={"point_sigma": 5e-5}),
        "dataset.yaml noise.point_sigma",
        "estimated",
    ),
    "misspelt key": (misspelt, "dataset.yaml strin", "Call it 'string'"),
    "misspelt column": (named_sigma, "points.csv Sigma", "Call it 'sigma'"),
    "no such trial": (
        about(trials={"t77": {"role": "held_out"}}),
        "dataset.yaml trials.t77",
        "Correct the name",
    ),
    "none valid": (none_valid, "points.csv valid", "a blank is false"),
    "two frames": (two_frames, "points.csv t", "takes more frames"),
    "stated to be invalid": (
        about(trials={"t03": {"invalid": "it slipped off"}}),
        "dataset.yaml trials.t03.invalid",
        "Take 'invalid' out",
    ),
    "points beyond": (beyond, "points.csv s, x, y", "Correct string.length"),
}


@pytest.mark.parametrize("kind", SUSPICIOUS)
def test_warnings_are_shown_as_text_and_as_json(dirty, tmp_path, kind):
    spoil, place, remedy = SUSPICIOUS[kind]
    spoil(dirty)
    here = read_checked(dirty.write(tmp_path))
    found = collect_findings(here)
    assert any(f"{f.file} {f.field}" == place and remedy in f.remedy for f in found), [
        f.sentence for f in found
    ]
    assert all(f.severity is not Severity.ERROR for f in found), [
        f.sentence for f in found
    ]
    for_programs = dataset_overview(here)["findings"]
    assert len(for_programs) == len(found)
    for one in for_programs:
        assert all(one[name] for name in ("file", "field", "statement", "remedy")), one


def test_the_suggested_command_describes_the_arm(dirty, tmp_path):
    undescribed(dirty)
    (finding,) = findings_in(dirty.write(tmp_path))
    assert finding.sentence.startswith(
        "dataset.yaml arm.links, arm.base: arm.csv has joint angles of an arm"
    )
    subprocess.run(["sh", "-c", finding.remedy.partition("one: ")[2]], check=True)
    assert findings_in(tmp_path) == []


def test_data_without_a_usable_trial_state_the_reason(dirty, called, tmp_path):
    none_left(dirty)
    done = called("check", dirty.write(tmp_path))
    assert done.returncode == 1
    assert (
        "error points.csv valid (trial t00, t02, t03): the trial is left out"
        in done.stdout
    )
    assert done.stdout.strip().endswith("Not usable: 1 error.")


def test_the_sample_has_no_findings_as_joints_poses_or_csv(dirty, tmp_path):
    assert findings_in(SAMPLE) == []
    assert findings_in(dirty.write(tmp_path)) == []
    (tmp_path / "arm.csv").unlink()
    assert findings_in(dirty.with_poses().write(tmp_path)) == []


def test_harmless_faults_give_only_notes(dirty, tmp_path):
    dirty.points.loc[100, "y"] = np.nan
    dirty.points = (
        pd.concat([dirty.points, dirty.points.iloc[:40]])
        .sample(frac=1, random_state=3)
        .assign(held=False)
    )
    dirty.with_poses()
    # a direction may be wrapped
    dirty.grasp["theta"] = np.angle(np.exp(1j * dirty.grasp["theta"]))
    findings = findings_in(dirty.write(tmp_path))
    assert {f.severity for f in findings} == {Severity.NOTE}
    assert any(
        "(1: y is not a finite number; 40: a row twice)" in f.statement
        for f in findings
    )


def long_running(dirty):
    for table in (dirty.arm, dirty.points):
        table["t"] += 1.75e9


def spiked(dirty):
    dirty.arm.loc[[30, 77], "q2"] += 0.5


def strays(dirty):
    for t in (dirty.points["t"].min(), 0.4):
        dirty.points.loc[len(dirty.points)] = {
            "trial": "t00",
            "t": t,
            "s": 7.0,
            "x": 0.1,
            "y": 0.2,
        }


def commas(dirty):
    """End lines with a comma and put blanks into names, as some programs do."""
    dirty.commas = True


DIRT = {
    "clocks that run for years": long_running,
    "spikes": spiked,
    "stray points": strays,
    "commas": commas,
}


@pytest.mark.parametrize("kind", DIRT)
def test_faulty_rows_do_not_change_the_data_read(dirty, tmp_path, kind):
    for name in ("clean", "dirty"):
        (tmp_path / name).mkdir()
    clean = dataset.read_dataset(dirty.write(tmp_path / "clean"))
    DIRT[kind](dirty)
    folder = dirty.write(tmp_path / "dirty")
    if kind == "commas":
        head, *lines = (folder / "arm.csv").read_text().splitlines()
        (folder / "arm.csv").write_text(
            "\n".join([head.replace(",", " ,"), *(f"{line}," for line in lines)])
        )
    here = read_checked(folder)
    assert not [f for f in collect_findings(here) if f.severity is Severity.ERROR]
    read = dataset.exclude_stray_points(here.data, here.length)
    assert set(read.trials) == set(clean.trials)
    for name, trial in read.trials.items():
        for table, keys in (("arm", ["t"]), ("points", ["t", "s"])):
            same = from_its_start(getattr(clean.trials[name], table)).merge(
                from_its_start(getattr(trial, table)), on=keys, suffixes=("", "_read")
            )
            assert len(same) >= len(getattr(clean.trials[name], table)) - 2
            columns = [c for c in same if f"{c}_read" in same]
            np.testing.assert_allclose(
                same[columns], same[[f"{c}_read" for c in columns]], atol=1e-9
            )


def from_its_start(table):
    return table.assign(t=(table["t"] - table["t"].min()).round(4))


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_right_casts_have_no_findings_whichever_points_are_seen(dirty, tmp_path, share):
    """Fewer points, fewer frames, or the tip alone are not suspicious."""
    kept = dirty.points["s"] >= (1 - 1e-9) * dirty.length * share
    dirty.points = dirty.points[kept]
    assert findings_in(dirty.write(tmp_path)) == []


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_marks_of_a_string_of_unknown_length_may_all_be_before_its_end(
    dirty, tmp_path, share
):
    """Only the length is missing: no unit or arm needs correction."""
    dirty.points = dirty.points[dirty.points["s"] <= share * dirty.length]
    marks = np.sort(dirty.points["s"].unique())[[-2, -1]]
    dirty.points = dirty.points[dirty.points["s"].isin(marks)]
    no_length(dirty)
    fields = {f.field for f in findings_in(dirty.write(tmp_path))}
    assert "string.length" in fields
    assert fields <= {"string.length", "s"}


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize(
    ("unit", "size", "slow"),
    [("centimetres", 1e2, 1.0), ("millimetres", 5e2, np.sqrt(0.5))],
)
def test_if_two_units_fit_the_fall_decides_and_both_are_stated(
    dirty, tmp_path, share, unit, size, slow
):
    """If two units fit, the fall decides, and both are stated.

    The test uses a whole string and its tip alone. 0.304 m in cm would be 30 mm if read
    in mm. Half that string in mm moves faster by the root of two. It would be 1.52 m if
    read in cm.
    """
    dirty.with_poses()
    dirty.points = dirty.points[dirty.points["s"] >= share * (1 - 1e-9) * dirty.length]
    for table in (dirty.grasp, dirty.points):
        table[["x", "y"]] *= size
        table["t"] *= slow
    dirty.points["s"] *= size
    dirty.about["string"]["length"] *= size
    worst = findings_in(dirty.write(tmp_path))[0]
    assert f"are in {unit}" in worst.statement
    assert worst.remedy.endswith("0.01" if unit == "centimetres" else "0.001")


@pytest.mark.parametrize(
    ("initial", "times", "lengths", "expected", "advice"),
    [
        ("rest", 8.0, 1.0, "an eighth of the pace", "slow motion"),
        ("moving", 8.0, 1.0, "seems to fall with", "slow motion"),
        ("rest", 1.0, 10.0, "are in decimetres", "by 0.1"),
    ],
)
def test_a_fall_that_contradicts_gravity_is_reported_once(
    dirty, tmp_path, initial, times, lengths, expected, advice
):
    """A film with 200 frames per second is played at 25, or units are decimetres.

    The motion of a string that begins to move earlier is not predicted.
    """
    dirty.about["initial"] = initial
    for table in (dirty.with_poses().grasp, dirty.points):
        table["t"] *= times
        table[["x", "y"]] *= lengths
    dirty.points["s"] *= lengths
    dirty.about["string"]["length"] *= lengths
    findings = findings_in(dirty.write(tmp_path))
    about_fall = [f for f in findings if re.search("pace|fall|decimetres", f.statement)]
    assert len(about_fall) == 1, [f.sentence for f in findings]
    assert expected in about_fall[0].statement
    assert advice in about_fall[0].remedy


def free_fall(t):
    """Return a trial whose tip falls freely while the string turns."""
    x, y = 2.0 * t, 3.0 * t - GRAVITY_M_S2 * t**2 / 2
    turn = 6.0 * t
    tip = pd.DataFrame({"t": t, "s": 0.3, "x": x, "y": y})
    inner = tip.assign(s=0.2, x=x - 0.1 * np.cos(turn), y=y - 0.1 * np.sin(turn))
    return SimpleNamespace(
        points=pd.concat([inner, tip]), hand_at=lambda t: np.zeros((len(t), 2))
    )


def test_a_free_fall_shows_gravity_though_frames_are_lost_and_uneven():
    rng = np.random.default_rng(0)
    even = np.arange(240) / 240
    lost = even[rng.random(240) > 0.2]
    uneven = even + rng.uniform(-0.2, 0.2, 240) / 240
    for t in (even, lost, uneven):
        assert estimate_gravity(free_fall(t)) == pytest.approx(GRAVITY_M_S2)


def test_a_string_that_stays_at_rest_does_not_fall(dirty, tmp_path):
    """A stiff one keeps the hand's direction and shows no gravity."""
    dirty.with_poses()
    for table, places in ((dirty.grasp, "trial"), (dirty.points, ["trial", "s"])):
        first = table.groupby(places)[["x", "y"]].transform("first")
        table[["x", "y"]] = first
    dirty.grasp["theta"] = 0.0
    hand = dirty.grasp.groupby("trial")[["x", "y"]].first()
    dirty.points["x"] = dirty.points["trial"].map(hand["x"]) + 0.8 * dirty.points["s"]
    dirty.points["y"] = dirty.points["trial"].map(hand["y"]) - 0.6 * dirty.points["s"]
    findings = findings_in(dirty.write(tmp_path))
    assert any("leaves its place" in finding.statement for finding in findings)
    assert not any("to fall with" in finding.statement for finding in findings)


SQUARE = Lens((500.0, 500.0), (160.0, 120.0), (0.0, 0.0, 0.0, 0.0))
# changes of a camera with 320 x 240 px, and the message if it is impossible
PICTURES = {
    "ordinary": ({}, ""),
    "barrel": ({"distortion": -0.1}, ""),
    "lens": (
        {
            "lens": replace(SQUARE, distortion=(-0.3, 0.1, 1e-3, 1e-3)),
            "tilt": (0.1, 0.0),
        },
        "",
    ),
    "folds at the corners": (
        {"distortion": -0.25},
        "warning .*% of the picture has no place",
    ),
    "folds": (
        {"lens": replace(SQUARE, distortion=(-50.0, 0.0, 0.0, 0.0))},
        "error .*% of the picture has no place",
    ),
    "no numbers": (
        {"lens": replace(SQUARE, distortion=(1e300, 0.0, 0.0, 0.0))},
        "error 100% of the picture",
    ),
    "px per mm": ({"px_per_m": 0.3}, "error .* as long as 0.00028 pictures are wide"),
    "nothing but string": ({"px_per_m": 1e5}, "error .* as long as 94 pictures"),
    "one focal length": (
        {"lens": replace(SQUARE, focal=(1e300, 500.0))},
        "error .* the string is as long as",
    ),
}


@pytest.mark.parametrize("kind", PICTURES)
def test_a_camera_that_cannot_show_the_string_is_reported(kind):
    changed, expected = PICTURES[kind]
    camera = Camera(
        **{
            "width": 320,
            "height": 240,
            "px_per_m": 300.0,
            "origin_px": (160.0, 120.0),
            "fps": 200.0,
        }
        | changed
    )
    filmed = SimpleNamespace(
        data=SimpleNamespace(films={"a": None}), camera=camera, length=0.3
    )
    statements = [
        f"{finding.severity} {finding.statement}"
        for finding in check_camera_view(filmed)
    ]
    assert len(statements) == bool(expected)
    assert not expected or re.match(expected, statements[0]), statements


def test_the_command_describes_the_data_and_its_status_states_usability(
    dirty, called, tmp_path
):
    good = called("check", SAMPLE)
    assert good.returncode == 0, good.stderr
    assert "Usable: 5 trials; nothing looks wrong" in good.stdout
    scaled("points", ["x", "y"], 1e3)(dirty)
    bad = called("check", dirty.write(tmp_path), "--json")
    assert bad.returncode == 1
    document = json.loads(bad.stdout)
    assert document["findings"][0]["remedy"] == "Multiply x and y by 0.001"
    assert document["findings"][0]["trials"] == TRIALS
    assert len(document["trials"]) == 3
    before = {file.name for file in tmp_path.iterdir()}
    run = called(
        "+experiment=diagnose",
        f"trials={tmp_path}",
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    assert run.returncode == 1
    assert "Multiply x and y by 0.001" in run.stderr
    assert "Traceback" not in run.stderr
    assert {file.name for file in tmp_path.iterdir()} == before


def test_a_page_shows_measurements_and_findings(dirty, called, undrawn, tmp_path):
    scaled("points", ["x", "y"], 1e3)(dirty)
    done = called("check", dirty.write(tmp_path), "--report", tmp_path / "page.html")
    assert done.stdout.strip().endswith("page.html")
    page = (tmp_path / "page.html").read_text()
    assert "These trials are not usable yet" in page
    assert "Multiply x and y by 0.001" in page
    assert page.count("<img") == len(TRIALS)
    assert 'class="wide"' not in page, "on a phone the clocks would lie beyond the edge"
    assert "Trial t03: 129 frames of a string of 304 mm" in page
    # the page works without a network
    assert "://" not in page.replace("http://www.w3.org", "")
    refused = called("check", tmp_path, "--report", tmp_path / "page.pdf")
    assert (refused.returncode, "must end in .html" in refused.stderr) == (2, True)


EFFECT = {
    "effect": "wind",
    "parameter": "along_x",
    "meaning": "velocity of the air to the right",
    "unit": "m/s",
    "absent": 0.0,
    "found_from": 0.021,
    "tip_m": 6.8e-4,
    "most_tip_m": 0.2,
    "imitated": 0.52,
    "alike": ["tip_mass"],
}


NOT_TRIED = {"contact": "it depends on the place"}


@pytest.mark.parametrize(
    ("seconds", "frequency"), [(0.9, None), (2.05, None), (4.0, 8), (10.0, 3)]
)
def test_the_frequency_that_a_diagnosis_resolves_is_noted_for_a_long_trial(
    seconds, frequency
):
    trial = SimpleNamespace(name="t1", frame_t=np.arange(0, seconds, 1 / 240))
    dataset = SimpleNamespace(trials=[trial], points_file="points.csv")
    statements = [finding.statement for finding in check_bandwidth(dataset)]
    if frequency is None:
        assert not statements
    else:
        assert f"up to {frequency} Hz" in statements[0]


def test_detection_limits_are_shown_if_requested(
    dirty, called, undrawn, tmp_path, monkeypatch
):
    calls = []
    monkeypatch.setattr(
        check_effects,
        "detectable_effects",
        lambda *given: calls.append(given) or ([EFFECT], NOT_TRIED),
    )
    folder = dirty.write(tmp_path)
    assert "wind" not in called("check", folder).stdout
    done = called(
        "check",
        folder,
        "--effects",
        "--report",
        tmp_path / "page.html",
        "string.points=15",
    )
    ((settings,),) = calls
    assert settings["trials"] == str(folder)
    assert settings["string"]["points"] == 15
    assert re.search(r"wind.along_x +0.021 m/s +0.7 +52% +tip_mass", done.stdout)
    assert "Not tried: contact (it depends on the place)." in done.stdout
    assert done.stdout.index("Found from:") < done.stdout.index("Usable: 3 trials")
    page = (tmp_path / "page.html").read_text()
    assert "Detectable effects" in page
    assert "0.021 m/s" in page
    assert json.loads(called("check", folder, "--effects", "--json").stdout)[
        "effects"
    ] == [EFFECT]
    none_left(dirty)
    assert "effects" not in json.loads(
        called("check", dirty.write(tmp_path), "--effects", "--json").stdout
    )
    assert len(calls) == 2


@pytest.mark.long
def test_detection_limits_of_the_sample(called):
    """The sample shows small offsets.

    It has half a metre of string and thousands of readings. It shows a camera offset of
    2 mm, the tolerance below which effects do not matter, and a small part of a frame
    in the clocks.
    """
    done = called(
        "check", SAMPLE, "--effects", "--json", "diagnose.excluded_effects=[wind]"
    )
    limits = {
        f"{each['effect']}.{each['parameter']}": each
        for each in json.loads(done.stdout)["effects"]
    }
    assert len(limits) > 25
    assert "wind.along_x" not in limits
    assert limits["camera_offset.x"]["found_from"] == pytest.approx(2e-3, rel=0.01)
    assert limits["time_offset.offset"]["found_from"] < 0.1 / 200
    assert all(each["tip_m"] >= 1.99e-3 for each in limits.values())


def test_unreadable_data_are_one_error(called, tmp_path):
    shutil.copytree(SAMPLE, tmp_path / "cut")
    file = tmp_path / "cut" / "points.parquet"
    file.write_bytes(file.read_bytes()[:-100])
    cut = called("check", tmp_path / "cut", "--json")
    assert cut.returncode == 1
    finding = json.loads(cut.stdout)["findings"][0]
    assert (finding["file"], finding["statement"][:24]) == (
        str(file),
        "not a whole Parquet file",
    )
    assert finding["remedy"] == "Restore it or delete it and run again"
    nowhere = called("check", tmp_path / "nowhere")
    assert nowhere.returncode == 1
    assert "there is no such folder" in nowhere.stdout
    assert "Traceback" not in nowhere.stderr + cut.stderr


def number_with_a_unit(folder):
    (folder / "dataset.yaml").write_text("string: {length: 30cm}")


def other_column(folder):
    arm = pd.read_csv(folder / "arm.csv")
    arm.rename(columns={"q1": "elbow"}).to_csv(folder / "arm.csv", index=False)


def own_names(folder):
    (folder / "arm.csv").rename(folder / "robot.csv")
    (folder / "points.csv").rename(folder / "tracker.csv")


def half_a_line(folder):
    (folder / "dataset.yaml").write_text("format: 1\nstring: {length: 0.3\n")


UNREAD = {  # file, field, and words of the remedy
    number_with_a_unit: ("dataset.yaml", "string.length", "Correct it"),
    half_a_line: ("dataset.yaml", "line 3", "Correct it"),
    other_column: ("arm.csv", "q1", "Add the column or rename yours"),
    own_names: ("", "", r"import .*robot.csv .*tracker.csv --to"),
}


@pytest.mark.parametrize("spoil", UNREAD, ids=lambda spoil: spoil.__name__)
def test_an_error_in_unreadable_data_names_file_field_and_remedy(
    dirty, called, tmp_path, spoil
):
    spoil(dirty.write(tmp_path))
    file, field, remedy = UNREAD[spoil]
    finding = json.loads(called("check", tmp_path, "--json").stdout)["findings"][0]
    assert (finding["file"], finding["field"]) == (
        str(tmp_path / file) if file else str(tmp_path),
        field,
    )
    assert re.search(remedy, finding["remedy"])


def test_clocks_with_and_without_the_epoch_of_1970_are_reported(dirty, tmp_path):
    dirty.arm["t"] += 1.764e9
    reasons = [
        f.statement
        for f in findings_in(dirty.write(tmp_path))
        if f.trials == tuple(TRIALS) and "overlap" in f.statement
    ]
    assert re.search(
        r"the arm's clock says 2025-11-24 .*camera's goes from -0.05 to", reasons[0]
    )


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured sets are not here")
@pytest.mark.parametrize("name", ["l4dc_strip_video", "tudelft_cable_fr3"])
def test_real_strings_have_no_errors_except_the_missing_description(
    name,
):
    findings = collect_findings(read_measurements(MEASURED / name, []))
    errors = collect_findings(
        read_measurements(MEASURED / name, ["string.length=0.75"])
    )
    assert all(f.severity is not Severity.ERROR for f in errors)
    assert all(
        "on a string of 0.300 m (string.length)" in f.statement
        for f in findings
        if f.severity is Severity.ERROR
    )
    assert {"string.length", "s", "t"} <= {f.field for f in findings}


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (("import", "a.csv", "--length", "short"), "--length"),
        (("import", "a.csv", "--frobnicate"), "--frobnicate"),
        (("check", SAMPLE, "--report", "page.txt"), "--report page.txt"),
        (("check",), ""),
    ],
)
def test_invalid_options_are_a_finding_in_json(called, words, field):
    done = called(*words, "--json")
    (finding,) = json.loads(done.stdout)["findings"]
    assert done.returncode == 1
    assert finding["field"] == field
    assert finding["remedy"]
    # a person reads a sentence
    plain = called(*words)
    assert not plain.stdout
    assert finding["statement"] in plain.stderr
