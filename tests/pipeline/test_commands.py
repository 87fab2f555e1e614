"""The commands verify, why, diff, lineage and index, on complete and damaged runs."""

import json
import re
import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stringcast.data import store
from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import Points
from stringcast.data.compare import file_differences
from stringcast.pipeline import __main__ as shell
from stringcast.pipeline import commands
from stringcast.pipeline.commands.index import RUNS_TABLE, list_runs
from stringcast.pipeline.commands.verify import verify_run
from stringcast.pipeline.modes import Batch, Calibrate
from stringcast.pipeline.run import provenance
from stringcast.pipeline.settings.composition import UserError
from tests.faults.toy import contents, rows, toy_experiment, toy_run

PAGE = Path(commands.__file__).with_name("README.md")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Perform two runs of two casts with different seeds."""
    outputs = tmp_path_factory.mktemp("outputs")
    toy_run(outputs / "day" / "a", toy_experiment())
    toy_run(outputs / "day" / "b", toy_experiment(seed=3))
    return outputs


@pytest.fixture
def run(finished, tmp_path):
    """Copy a complete run, to be damaged."""
    return shutil.copytree(finished / "day" / "a", tmp_path / "run")


def run_line(capsys, *command):
    """Return the exit status of a command, and its output on one line."""
    status = shell.run_command(command[0], [str(word) for word in command[1:]])
    output = capsys.readouterr()
    return status, re.sub(r"\s+", " ", output.out + output.err)


def verify(run, tmp_path, here):
    @contextmanager
    def bar(name):
        yield lambda share: None

    (tmp_path / "aside").mkdir()
    return verify_run(here, run, tmp_path / "aside", bar)


def change(run, step, table, column, row, value):
    """Change a value in a stored table, with the same origin."""
    file = run / "iterations" / step / f"{table.name}.parquet"
    frame = store.read_table(table, file)
    frame.loc[row, column] = value(frame.loc[row, column])
    store.write_table(table, frame, file, store.read_origin(file))


def test_verify_does_not_change_a_run(run, tmp_path):
    before = {p: (p.stat().st_mtime_ns, p.stat().st_size) for p in run.rglob("*")}
    outcome = verify(run, tmp_path, toy_experiment())
    assert outcome.is_same
    assert len(outcome.lines) == 10
    assert all(line.endswith("the same to the bit") for line in outcome.lines)
    assert {
        p: (p.stat().st_mtime_ns, p.stat().st_size) for p in run.rglob("*")
    } == before


def test_verify_reports_position_and_size_of_differences(run, tmp_path):
    change(
        run,
        "02/points",
        Points.TABLES["points"],
        "x",
        1,
        lambda x: np.nextafter(x, 1e9),
    )
    outcome = verify(run, tmp_path, toy_experiment())
    assert not outcome.is_same
    at = outcome.lines.index("iterations/02/points: DIFFERS")
    assert re.search(
        r"points\.parquet: column x: 1 of 2 rows differ, first row 1: .* at most .*e-1\d apart",
        outcome.lines[at + 1],
    )
    assert "iterations/01/points: the same to the bit" in outcome.lines
    # it was made from points that no longer exist
    assert "iterations/02/estimate: DIFFERS" in outcome.lines
    assert any(
        "input iterations/02/points has changed" in line for line in outcome.lines
    )


def test_verify_detects_changed_images_summary_and_missing_steps(run, tmp_path):
    image = run / "iterations/01/trial/images/0.png"
    shutil.copy(image.with_name("1.png"), image)
    (run / "run.json").write_text(
        (run / "run.json").read_text().replace('"hit": false', '"hit": true', 1)
    )
    lines = "\n".join(verify(run, tmp_path, toy_experiment()).lines)
    assert "images/0.png: 256 pixels differ, at most by 1 grey levels" in lines
    assert "it differs from the summary of the steps" in lines
    shutil.rmtree(run / "iterations/02/points")
    shutil.rmtree(tmp_path / "aside")
    outcome = verify(run, tmp_path, toy_experiment())
    assert not outcome.is_same
    assert outcome.lines[-2:] == [
        "iterations/02/points: DIFFERS",
        "    it has not been made yet",
    ]


def aligned(model, observations, films, *, progress):
    return Alignment(
        **{name: rows(table, 1) for name, table in Alignment.TABLES.items()}
    )


def test_verify_accepts_a_run_without_points(tmp_path):
    """An alignment films the arm alone, so it has no points and no dataset."""
    mode = Batch(stage="align", reading=(), again=False, first=("generate", "execute"))
    here = toy_experiment(1, mode=mode)
    here = replace(here, stages={**here.stages, "align": aligned})
    toy_run(tmp_path / "run", here)
    assert (tmp_path / "run" / "extended.yaml").exists()
    outcome = verify(tmp_path / "run", tmp_path, here)
    assert outcome.is_same
    assert [line.partition(":")[0] for line in outcome.lines] == [
        *(f"iterations/01/{name}" for name in ("motion", "trial", "alignment")),
        "run.json",
    ]


def real_arm():
    """Return the toy experiment with a real arm."""
    here = toy_experiment()
    hardware = {**here.config["hardware"], "_target_": "hardware.serial.lab.open_lab"}
    return toy_experiment(hardware=hardware)


def test_trials_of_a_real_arm_are_never_replaced(tmp_path, monkeypatch):
    toy_run(tmp_path / "run", real_arm())
    outcome = verify(tmp_path / "run", tmp_path, real_arm())
    assert outcome.is_same
    assert (
        outcome.lines[1]
        == "iterations/01/trial: measured with a real arm and camera, cannot be computed again"
    )
    before = contents(tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr(provenance, "code_state", changed_code)
        made, output = toy_run(tmp_path / "run", real_arm())
    assert made == ["extract", "estimate"]  # no arm has moved after these
    assert "keeping iterations/01/motion, by which the arm has moved: " in output
    assert contents(tmp_path / "run") == before
    trial = tmp_path / "run/iterations/01/trial/arm.parquet"
    trial.write_bytes(trial.read_bytes()[:-5])
    with pytest.raises(Exception, match=r"arm\.parquet.*cannot be made again"):
        toy_run(tmp_path / "run", real_arm())


def changed_code():
    """Return the state of changed code."""
    return {"commit": "0" * 40, "source": "0" * 64}


def test_code_change_makes_all_steps_stale(run, monkeypatch):
    assert toy_run(run, toy_experiment())[0] == []
    monkeypatch.setattr(provenance, "code_state", changed_code)
    made, output = toy_run(run, toy_experiment())
    assert made == ["generate", "execute", "extract", "estimate"] * 2
    assert "the code has changed" in output
    assert toy_run(run, toy_experiment())[0] == []


def test_why_names_changed_setting_package_and_input(run, capsys, monkeypatch):
    assert run_line(capsys, "why", run) == (
        0,
        " ".join(
            f"iterations/{n}/{s}: fresh"
            for n in ("01", "02")
            for s in ("motion", "trial", "points", "estimate")
        )
        + " ",
    )
    config = json.loads((run / "config.json").read_text())
    config["estimate"]["beta"] = 0.9
    (run / "config.json").write_text(json.dumps(config))
    status, output = run_line(capsys, "why", run)
    assert status == 1
    assert "iterations/01/points: fresh" in output
    assert "iterations/01/estimate: stale estimate.beta 0.995 -> 0.9" in output
    assert (
        "iterations/02/motion: stale iterations/01/estimate, an input, is stale"
        in output
    )
    change(run, "01/points", Points.TABLES["points"], "x", 0, lambda x: x + 1)
    status, output = run_line(capsys, "why", run / "iterations/01/estimate")
    assert "input iterations/01/points has changed" in output
    assert "motion" not in output
    real = provenance.step_origin
    monkeypatch.setattr(
        provenance,
        "step_origin",
        lambda *given: (
            real(*given) | {"packages": {**real(*given)["packages"], "numpy": "9.9"}}
        ),
    )
    assert re.search(r"package numpy [\d.]+ -> 9\.9", run_line(capsys, "why", run)[1])


def test_diff_lists_differences_and_their_possible_cause(finished, run, capsys):
    same = run_line(capsys, "diff", finished / "day/a", run)
    assert same == (
        0,
        "settings: the same data: the same code: the same packages: the same results: the same "
        "The two runs are the same in everything that was compared. ",
    )
    status, output = run_line(capsys, "diff", finished / "day/a", finished / "day/b")
    assert status == 1
    assert "settings: differ seed: 0 and 3" in output
    assert (
        "code: the same packages: the same results: differ run.json: iterations.1.E_after:"
        in output
    )
    assert re.search(
        r"iterations/01/motion/commands.parquet: column q1: 2 of 2 rows differ, first row 0: ",
        output,
    )
    assert re.search(
        r"(Both runs|The first run) .*\. What can explain it: settings \(seed\)\. $",
        output,
    )
    (run / "points.parquet").unlink()
    output = run_line(capsys, "diff", finished / "day/a", run)[1]
    assert "Nothing that they were made of differs: check the machines." in output
    assert (
        "points.parquet: it is only in the first"
        in run_line(capsys, "diff", finished / "day/a", run)[1]
    )


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        ({"x": [1.0]}, {"x": [1.0]}, []),
        ({"x": [0.0, np.nan]}, {"x": [-0.0, np.nan]}, ["column x: 1 of 2 rows differ, first row 0: 0.0 and -0.0, at most 0 apart (row 0)"]),
        ({"x": [1.0], "y": [1]}, {"y": [1], "x": [1.0]}, ["columns are x, y and y, x"]),
        ({"x": [1.0]}, {"x": [1]}, ["column x is double and int64"]),
        ({"x": [1.0]}, {"x": [1.0, 2.0]}, ["it has 1 and 2 rows"]),
        ({"x": ["a", "b"]}, {"x": ["a", "c"]}, ["column x: 1 of 2 rows differ, first row 1: 'b' and 'c'"]),
        ({"x": [1.0, 2.0]}, {"x": [1.0, np.nan]}, ["column x: 1 of 2 rows differ, first row 1: 2.0 and nan"]),
        ({"x": [1.0, 5.0, 2.0]}, {"x": [1.5, 5.0, 4.0]}, ["column x: 2 of 3 rows differ, first row 0: 1.0 and 1.5, at most 2 apart (row 2)"]),
    ],
)  # fmt: skip
def test_table_differences_name_columns_types_rows_and_values(tmp_path, a, b, words):
    for name, table in (("a", a), ("b", b)):
        pd.DataFrame(table).to_parquet(tmp_path / f"{name}.parquet")
    assert file_differences(tmp_path / "a.parquet", tmp_path / "b.parquet") == words


def test_lineage_reaches_the_first_motion_and_marks_changes(run, capsys):
    status, output = run_line(
        capsys, "lineage", run / "iterations/02/estimate/fit.parquet"
    )
    assert status == 0
    for words in (
        "made by estimate",
        "estimate.beta=0.995",
        "iterations/02/trial",
        "iterations/01/motion",
        "made by generate",
        "numpy ",
        "commit ",
    ):
        assert words in output
    change(run, "01/points", Points.TABLES["points"], "x", 0, lambda x: x + 1)
    status, output = run_line(capsys, "lineage", run / "report.html")
    assert status == 1
    assert "iterations/01/points HAS CHANGED SINCE" in output
    shutil.rmtree(run / "iterations/01/motion")
    assert (
        "iterations/01/motion IS GONE"
        in run_line(capsys, "lineage", run / "iterations/01/trial/images/0.png")[1]
    )


@pytest.fixture
def many(finished, tmp_path):
    """Return runs that ended, failed, stopped, or are damaged, stale or outdated."""
    outputs = shutil.copytree(finished, tmp_path / "outputs")
    for name in ("failed", "interrupted", "damaged", "stale", "old"):
        shutil.copytree(outputs / "day/a", outputs / "day" / name)
    for name in ("failed", "interrupted"):
        (outputs / "day" / name / "run.json").unlink()
    (outputs / "day/failed/failed.txt").write_text("the camera is not there\n")
    (outputs / "day/damaged/iterations/01/estimate/fit.parquet").write_bytes(b"t")
    shutil.rmtree(outputs / "day/interrupted/iterations/02/estimate")
    config = outputs / "day/stale/config.json"
    config.write_text(config.read_text().replace('"points": 31', '"points": 30'))
    old = outputs / "day/old/config.json"
    old.write_text(old.read_text().replace('"integrator"', '"method"'))
    return outputs


def test_index_counts_trials_and_causes_of_a_diagnosis(tmp_path):
    """One step uses all trials, so steps are not counted."""
    step = tmp_path / "iterations/05/diagnosis"
    step.mkdir(parents=True)
    store.write_table(RUNS_TABLE, RUNS_TABLE.empty(), step / "x.parquet", {})
    rows = [{"number": number} for number in range(1, 6)]
    summary = {"sentence": "So.", "iterations": rows}
    (tmp_path / "run.json").write_text(json.dumps(summary))
    causes = [{"effect": "wind"}, {"effect": "clamp"}]
    document = {"verdict": "effect", "causes": causes}
    (tmp_path / "diagnosis.json").write_text(json.dumps(document))
    (tmp_path / "config.json").write_text('{"name": "d", "mode": {}}')
    runs = list_runs(tmp_path).iloc[0]
    assert (runs["iterations"], runs["outcome"]) == (5, "effect"), runs["message"]
    assert runs["causes"] == "wind, clamp"


def test_index_lists_runs_with_their_outcome(many, capsys, tmp_path):
    for to in ("runs.html", "runs.parquet", "runs.csv"):
        status, output = run_line(capsys, "index", many, "--to", tmp_path / to)
        assert status == 0
    assert "day/a" in output
    runs = pd.read_parquet(tmp_path / "runs.parquet").set_index("run")
    assert dict(runs["state"]) == {
        "day/a": "ended",
        "day/b": "ended",
        "day/failed": "failed",
        "day/interrupted": "incomplete",
        "day/damaged": "damaged",
        "day/stale": "ended",
        "day/old": "ended",
    }
    assert runs.loc["day/a", "outcome"] == "missed"
    assert runs.loc["day/failed", "message"] == "the camera is not there"
    assert (
        runs.loc["day/stale", "stale"]
        == "iterations/01/points: extract.points 31 -> 30"
    )
    # the setting has another name
    assert "string.integrator._target_" in runs.loc["day/old", "stale"]
    assert (runs.drop(["day/stale", "day/old"])["stale"] == "").all()
    fits = [
        pd.read_parquet(many / f"day/a/iterations/{n}/estimate/fit.parquet")["after"][0]
        for n in ("01", "02")
    ]
    assert runs.loc["day/a", "best_E"] == max(fits)
    assert runs.loc["day/a", "iterations"] == 2
    assert (runs["causes"] == "").all()
    assert 0 < runs.loc["day/a", "seconds"] < 60
    assert runs.loc["day/a", "date"].startswith("20")
    listed = pd.read_csv(
        tmp_path / "runs.csv",
        keep_default_na=False,
        converters={"best_E": lambda E: float(E or "nan")},
    )
    pd.testing.assert_frame_equal(listed, runs.reset_index(), check_dtype=False)
    page = (tmp_path / "runs.html").read_text()
    linked = [tmp_path / where for where in re.findall(r'href="([^"]*)"', page)]
    assert (many / "day/a/report.html").resolve() in {path.resolve() for path in linked}
    assert all(path.is_file() for path in linked)
    assert "day/failed" in page


def test_commands_refuse_folders_that_are_not_runs(run, tmp_path, capsys):
    for command in (
        ["verify", tmp_path],
        ["resume", tmp_path],
        ["why", tmp_path],
        ["diff", tmp_path, run],
        ["lineage", tmp_path / "x"],
        ["index", tmp_path / "x"],
    ):
        status, output = run_line(capsys, *command)
        assert status == 2
        assert output.startswith("Error: ")
        assert str(tmp_path) in output.replace(" ", "")
    status, output = run_line(capsys, "index", tmp_path, "--to", "runs.xlsx")
    assert (status, "must end in .html, .parquet or .csv" in output) == (2, True)


def test_all_commands_are_listed_and_have_help(capsys):
    listed = dict(
        line.split(maxsplit=1) for line in commands.command_list().splitlines()
    )
    assert {*listed} == {*commands.COMMAND_NAMES}
    for name, words in listed.items():
        with pytest.raises(SystemExit) as stopped:
            commands.load_command(name)(["--help"])
        assert stopped.value.code == 0
        output = re.sub(r"\s+", " ", capsys.readouterr().out)
        assert re.sub(r"\s+", " ", words) in output
        assert f"pipeline {name}" in output


def blocks(language):
    """Return the examples on the page, in order."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_pandas_examples_of_the_page_run(finished, tmp_path, monkeypatch, capsys):
    outputs = shutil.copytree(finished, tmp_path / "outputs")
    monkeypatch.chdir(outputs.parent)
    run_line(capsys, "index", "outputs", "--to", "runs.parquet")
    assert blocks("python")
    for code in blocks("python"):
        known = {}
        exec(code, known)
        assert len(known["answer"])


def test_duckdb_examples_of_the_page_run(finished, tmp_path, monkeypatch, capsys):
    duckdb = pytest.importorskip("duckdb")
    outputs = shutil.copytree(finished, tmp_path / "outputs")
    monkeypatch.chdir(outputs.parent)
    run_line(capsys, "index", "outputs", "--to", "runs.parquet")
    assert blocks("sql")
    for query in blocks("sql"):
        assert len(duckdb.sql(query).df()), query


def test_calibration_has_no_steps_to_verify(tmp_path):
    """Its setting `trials` is not read as a dataset."""
    study = toy_experiment(mode=Calibrate(), trials=str(tmp_path))
    with pytest.raises(
        UserError,
        match="this run, of a study or a calibration, has no steps of its own",
    ):
        verify(tmp_path, tmp_path, study)


def test_input_hashes_search_run_and_working_folder(tmp_path, monkeypatch):
    """`trials` may be relative to the working folder of the command."""
    monkeypatch.chdir(tmp_path)
    for name in ("data/arm.csv", "run/iterations/01/points/points.csv", "secret"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"t")
    asked_for = {
        "data/arm.csv": "",
        "iterations/01/points": "",
        "secret": "",
        "data/gone.csv": "",
    }
    found = provenance.input_hashes(tmp_path / "run", asked_for, "data")
    assert set(found) == {"data/arm.csv", "iterations/01/points"}
