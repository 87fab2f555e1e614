"""Commands on damaged or malicious foreign runs."""

import json
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stringcast.data import store
from stringcast.data.errors import ExpectedError
from stringcast.data.schema import DataError
from stringcast.data.store import images_not_kept, read_origin
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.commands.index import neutralise_formula
from stringcast.pipeline.commands.verify import verify_run
from stringcast.pipeline.run import report
from stringcast.pipeline.run.provenance import input_hashes
from stringcast.pipeline.run.single_run import perform_run
from stringcast.pipeline.settings.composition import UserError
from tests.faults.toy import toy_experiment, toy_run
from tests.pipeline.test_frames_not_kept import silent


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Perform a whole run of one cast."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    toy_run(folder, toy_experiment(1))
    return folder


@pytest.fixture
def run(finished, tmp_path):
    """Copy a complete run, to be damaged."""
    return shutil.copytree(finished, tmp_path / "outputs" / "run")


def rewrite_origin(path, change):
    """Replace the origin in a table's footer by a text."""
    table = pq.read_table(path)
    metadata = dict(table.schema.metadata)
    origin = json.loads(metadata[b"origin"])
    metadata[b"origin"] = change(origin).encode()
    pq.write_table(table.replace_schema_metadata(metadata), path)


NESTED = "[" * 100_000
FOOTERS = {
    "list": lambda origin: "[1, 2]",
    "nested": lambda origin: NESTED,
    "inputs": lambda origin: json.dumps({**origin, "inputs": ["/usr"]}),
    "numbers": lambda origin: json.dumps({**origin, "inputs": {"a": 1}}),
    "code": lambda origin: json.dumps({**origin, "code": "new"}),
    "made": lambda origin: json.dumps({**origin, "made": {"at": 1}}),
    "many": lambda origin: json.dumps(
        {**origin, "inputs": dict.fromkeys(map(str, range(10_001)), "0")}
    ),
}


@pytest.mark.parametrize("footer", FOOTERS)
def test_malformed_footer_gives_one_error(run, capsys, footer):
    path = run / "iterations/01/estimate/fit.parquet"
    for table in path.parent.glob("*.parquet"):
        rewrite_origin(table, FOOTERS[footer])
    with pytest.raises(DataError, match="its footer does not say what made it"):
        read_origin(path)
    assert load_command("why")([str(run)]) == 1
    assert "its footer does not say what made it" in capsys.readouterr().out
    assert load_command("index")([str(run.parent)]) == 0
    with pytest.raises(DataError, match="its footer"):
        load_command("lineage")([str(path)])


def test_huge_footer_is_not_read(run, capsys):
    """Arrow would need many times its size."""
    path = run / "iterations/01/estimate/fit.parquet"
    with path.open("r+b") as file:
        file.truncate(2**31)  # sparse: it takes no space
        file.seek(-8, 2)
        file.write((2**30).to_bytes(4, "little") + b"PAR1")
    assert load_command("why")([str(run)]) == 1
    assert "its footer has 1073741824 bytes" in capsys.readouterr().out
    assert load_command("index")([str(run.parent)]) == 0
    with pytest.raises(DataError, match="its footer has"):
        load_command("diff")([str(run), str(run)])


def test_folder_named_repeatedly_by_footers_is_read_once(run, monkeypatch):
    names = ["iterations/" + "./" * times + "01/points" for times in range(50)]
    inputs = {"inputs": dict.fromkeys(names, "0")}
    for table in run.glob("iterations/01/estimate/*.parquet"):
        rewrite_origin(table, lambda origin: json.dumps(origin | inputs))
    read = []
    content_hash = store.content_hash
    monkeypatch.setattr(
        "stringcast.data.store.content_hash",
        lambda path: read.append(path) or content_hash(path),
    )
    load_command("lineage")([str(run / "iterations/01/estimate/fit.parquet")])
    assert len(read) == len(set(read))
    input_hashes(run, names, None)
    assert len(read) - len(set(read)) == 1  # once for either


@pytest.mark.parametrize("name", ["iterations/01/x.bin", "iterations/01/x.png"])
def test_huge_file_is_not_compared(run, capsys, name):
    other = shutil.copytree(run, run.parent / "other")
    for folder in (run, other):
        with (folder / name).open("wb") as file:
            file.truncate(2**40)  # sparse: it takes no space
    assert load_command("diff")([str(run), str(other)]) == 1
    assert "at most 268435456 are read" in capsys.readouterr().out


def test_foreign_folder_named_by_a_footer_is_not_read(
    run, capsys, monkeypatch, tmp_path
):
    """Reading `/usr` would take hours."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "file").write_text("private")
    inputs = {str(elsewhere): "0" * 64}
    for table in run.glob("iterations/01/*/*.parquet"):
        rewrite_origin(table, lambda origin: json.dumps({**origin, "inputs": inputs}))
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps({**config, "trials": str(elsewhere)}))
    opened = []
    monkeypatch.setattr(
        "stringcast.data.store.content_hash",
        lambda path: opened.append(path) or "0" * 64,
    )
    load_command("why")([str(run)])
    load_command("index")([str(run.parent)])
    load_command("lineage")([str(run / "iterations/01/estimate/fit.parquet")])
    assert elsewhere not in opened
    printed = "".join(capsys.readouterr().out.split())
    assert f"{elsewhere}ISGONE" in printed


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"mode": 1}', '{"mode": 1, "name": {}}', "\0" * 2**21]
)
def test_damaged_run_is_listed_by_index(run, tmp_path, text):
    hostile = run.parent / "hostile"
    hostile.mkdir()
    (hostile / "config.json").write_text(f'"mode"{text}' if text == "{" else text)
    (hostile / "run.json").write_text("[]")
    to = tmp_path / "runs.parquet"
    assert load_command("index")([str(run.parent), "--to", str(to)]) == 0
    states = pd.read_parquet(to).set_index("run")["state"]
    assert states["run"] == "ended"
    assert states.get("hostile", "damaged") == "damaged"


CAST = {"number": 1, "hit": True, "miss_m": 0.1}
SUMMARIES = {
    "no mapping": {"iterations": ["hit"]},
    "a mapping": {"iterations": {"hit": 1}},
    "a text": {"iterations": [CAST | {"miss_m": "near"}]},
    "a list": {"iterations": [CAST | {"miss_m": [0.1]}]},
    "too large": {"iterations": [CAST | {"miss_m": 10**400}]},
    "infinite": {"iterations": [CAST | {"E_after": float("inf")}]},
    "no number": {"iterations": [CAST | {"number": None}]},
    "no sentence": {"sentence": None},
    "no hit of the run": {"hit": None},
}


def test_malformed_summary_gives_one_error(run, tmp_path):
    summary = {"hit": True, "sentence": "It hit.", "iterations": [CAST]}
    for name, change in {"good": {}, **SUMMARIES}.items():
        other = shutil.copytree(run, run.parent / name)
        (other / "run.json").write_text(json.dumps(summary | change))
    for ending in ("html", "csv"):
        to = tmp_path / f"runs.{ending}"
        assert load_command("index")([str(run.parent), "--to", str(to)]) == 0
    states = pd.read_csv(to).set_index("run")["state"]
    assert states["good"] == "ended"
    for name in SUMMARIES:
        assert states[name] == "damaged", name
        with pytest.raises(DataError, match="does not say how the run ended"):
            load_command("diff")([str(run), str(run.parent / name)])


@pytest.mark.parametrize("verdict", [5, ["effect"], "\ud800"])
def test_malformed_verdict_is_listed_by_index(run, tmp_path, verdict):
    document = {"verdict": verdict, "causes": []}
    (run / "diagnosis.json").write_text(json.dumps(document))
    for ending in ("html", "parquet", "csv"):
        to = str(tmp_path / f"runs.{ending}")
        assert load_command("index")([str(run.parent), "--to", to]) == 0


def test_csv_for_spreadsheets_holds_no_formula():
    assert neutralise_formula("=1+1") == "'=1+1"
    assert neutralise_formula("@SUM(A1)") == "'@SUM(A1)"
    assert neutralise_formula("\n=1+1") == "'\n=1+1"
    assert neutralise_formula("＝1+1") == "'＝1+1"
    assert neutralise_formula("\x1b[2J") == r"\x1b[2J"
    assert neutralise_formula("a run") == "a run"
    assert neutralise_formula(-1.5) == -1.5


def test_failing_page_loses_only_the_page(tmp_path, monkeypatch, capsys):
    def fail(*given):
        raise ValueError("no such colour")

    monkeypatch.setattr(report, "write_report", fail)
    folder = tmp_path / "run"
    with (tmp_path / "said").open("w") as said:
        perform_run(toy_experiment(1), folder, Terminal(file=said, width=1000))
    assert "report.html was not drawn" in (tmp_path / "said").read_text()
    assert (folder / "run.json").exists()
    assert "no such colour" in (folder / "run.log").read_text()
    assert not (folder / "report.html").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"hardware": None},
        {"seed": None},
        {"trials": 5},
        {"mode": 5},
        {"estimate": 5},
        {"plugins": ["a\0b"]},
    ],
)
def test_malformed_settings_give_one_error(run, change):
    config = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(config | change))
    with pytest.raises(ExpectedError):
        load_command("why")([str(run)])
    assert load_command("index")([str(run.parent)]) == 0


@pytest.mark.parametrize("name", ["string", "effects"])
def test_run_without_a_string_setting_is_not_exported(run, tmp_path, name):
    config = json.loads((run / "config.json").read_text())
    del config[name]
    (run / "config.json").write_text(json.dumps(config))
    with pytest.raises(UserError, match=f"the setting '{name}' is missing"):
        load_command("export")([str(run), str(tmp_path / "string.csv")])


def test_repeated_parameter_gives_one_error(run, tmp_path):
    file = run / "iterations/01/estimate/parameters.parquet"
    table = pq.read_table(file)
    pq.write_table(pa.concat_tables([table, table]), file)
    with pytest.raises(UserError, match="it has a parameter twice"):
        load_command("export")([str(run), str(tmp_path / "string.csv")])


def test_folders_that_are_not_iterations_are_ignored(run):
    (run / "iterations/01").rename(run / "iterations/xx")
    with pytest.raises(UserError, match="no step"):
        load_command("why")([str(run)])


@pytest.mark.parametrize("part", ["step", "seed", "config", "packages", "python"])
def test_incomplete_footer_gives_no_traceback(run, part):
    step = run / "iterations/01/estimate"
    for table in step.glob("*.parquet"):
        rewrite_origin(
            table,
            lambda origin: json.dumps({k: v for k, v in origin.items() if k != part}),
        )
    assert load_command("lineage")([str(step / "fit.parquet")]) == 0
    is_compared = part in ("config", "packages", "python")
    made, _ = toy_run(run, toy_experiment(1))
    assert made == (["estimate"] if is_compared else [])


@pytest.mark.parametrize("part", ["inputs", "packages", "python", "code"])
def test_runs_with_incomplete_footers_are_compared(run, part):
    other = shutil.copytree(run, run.parent / "other")
    for table in other.glob("iterations/01/*/*.parquet"):
        rewrite_origin(
            table,
            lambda origin: json.dumps({k: v for k, v in origin.items() if k != part}),
        )
    rewrite_origin(
        other / "arm.parquet", lambda origin: json.dumps(origin | {"code": {}})
    )
    assert load_command("diff")([str(run), str(other)]) == 1


def test_few_bytes_that_encode_many_frames_are_refused(run):
    trial = run / "iterations/01/trial"
    frames = pd.DataFrame({"file": ["a"], "sha256": ["b"]})
    many = pa.Table.from_pandas(frames).take(pa.array(np.zeros(20_000_000, int)))
    pq.write_table(many, trial / "frames.parquet")
    assert (trial / "frames.parquet").stat().st_size < 1_000_000
    with pytest.raises(DataError, match="would take"):
        images_not_kept(trial)


def test_damaged_summary_is_reported_by_verify(run, tmp_path):
    (run / "run.json").write_text("{")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    outcome = verify_run(toy_experiment(1), run, scratch, silent)
    assert not outcome.is_same
    assert "damaged" in outcome.lines[-1]


def test_huge_frame_is_not_read(run, capsys):
    with (run / "iterations/01/trial/images/1.png").open("wb") as file:
        file.truncate(2**40)  # sparse: it takes no space
    assert load_command("why")([str(run)]) == 1
    assert "Make it smaller" in capsys.readouterr().out
