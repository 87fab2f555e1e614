"""Mutated files give one error or an answer.

No command ends in a traceback, hangs, or writes outside its run. Earlier findings are
tests in tests/foreign.
"""

import io
import json
import shutil
from itertools import count

import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from stringcast.data import dataset
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.run.single_run import perform_run
from tests.experiments import resolve_settings
from tests.fuzzing.guard import run_guarded
from tests.fuzzing.mutations import damaged_bytes, damaged_csv, damaged_document
from tests.importing.test_readers import FRAMES, JOINT_STATE, POINT
from tests.pipeline.test_readme_commands import ROOT

pytestmark = pytest.mark.long
SOME_SECONDS = "0.002"  # [h] a step of a hostile run may take
GEOMETRY = ["--length", "282mm", "--links", "0.25,0.20,0.135", "--base", "0.2,0.2"]
NUMBERS = count()


def fuzzed(examples):
    return settings(
        max_examples=examples,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        # to explain, every line would be traced, which takes minutes
        phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],
        print_blob=True,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return a real run of one cast."""
    folder = tmp_path_factory.mktemp("good") / "run"
    quick = resolve_settings("+experiment=quick", "saved_outputs=[frames]")
    perform_run(prepare_experiment(quick, lambda block: block), folder, quiet())
    return folder


def quiet():
    return Terminal(quiet=True)


@pytest.fixture
def sandbox(tmp_path_factory):
    """Return a function that makes an empty folder for each example."""
    top = tmp_path_factory.mktemp("fuzz")

    def make_folder():
        for old in top.iterdir():
            shutil.rmtree(old, ignore_errors=True)
        folder = top / str(next(NUMBERS))
        folder.mkdir()
        return folder

    return make_folder


def run_commands(commands, inside):
    """Run commands with their words under guard."""
    for name, words in commands.items():
        run_guarded(load_command(name), [str(word) for word in words], inside)


def ask_all(folder, inside):
    """Run all commands on a run, and continue it."""
    fit = next(iter(folder.glob("iterations/01/estimate/fit.parquet")), folder)
    commands = {
        "why": [folder],
        "index": [folder.parent, "--to", inside / "runs.csv"],
        "lineage": [fit],
        "diff": [folder, folder],
        "export": [folder, inside / "string.csv"],
        "resume": [folder, "--max-core-hours", SOME_SECONDS],
        "verify": [folder, "--max-core-hours", SOME_SECONDS],
    }
    run_commands(commands, inside)


@fuzzed(30)
@given(data=st.data())
def test_mutated_settings_of_a_run_crash_no_command(run, sandbox, data):
    inside = sandbox()
    folder = shutil.copytree(run, inside / "outputs" / "run")
    config = json.loads((run / "config.json").read_text())
    text = json.dumps(data.draw(damaged_document(config))).encode()
    if data.draw(st.integers(0, 4)) == 0:
        text = data.draw(damaged_bytes(text))
    (folder / "config.json").write_bytes(text)
    ask_all(folder, inside)


@fuzzed(30)
@given(data=st.data())
def test_mutated_footers_of_tables_crash_no_command(run, sandbox, data):
    inside = sandbox()
    folder = shutil.copytree(run, inside / "outputs" / "run")
    files = sorted(folder.rglob("*.parquet"))
    file = data.draw(st.sampled_from(files))
    table = pq.read_table(file)
    metadata = dict(table.schema.metadata)
    origin = json.loads(metadata[b"origin"])
    metadata[b"origin"] = json.dumps(data.draw(damaged_document(origin))).encode()
    siblings = file.parent.glob("*.parquet") if data.draw(st.booleans()) else [file]
    for path in siblings:
        part = pq.read_table(path)
        pq.write_table(part.replace_schema_metadata(metadata), path)
    ask_all(folder, inside)


@fuzzed(30)
@given(data=st.data())
def test_mutated_bytes_of_a_run_crash_no_command(run, sandbox, data):
    inside = sandbox()
    folder = shutil.copytree(run, inside / "outputs" / "run")
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    files = [path for path in files if path.suffix != ".png"]
    for _ in range(data.draw(st.integers(1, 3))):
        file = data.draw(st.sampled_from(files))
        file.write_bytes(data.draw(damaged_bytes(file.read_bytes())))
    ask_all(folder, inside)


@pytest.fixture(scope="module")
def tables():
    """Return the texts of a small dataset with CSV tables."""
    stored = dataset.read_dataset(ROOT / "data/sample")
    names = list(stored.trials)[:2]
    texts = {"dataset.yaml": (ROOT / "data/sample/dataset.yaml").read_text()}
    for name in ("points", "arm"):
        table = pd.read_parquet(ROOT / f"data/sample/{name}.parquet")
        table = table[table["trial"].isin(names)]
        texts[f"{name}.csv"] = table.to_csv(index=False)
    return texts


def look_at(folder, inside):
    """Run all commands on a dataset."""
    commands = {
        "check": [folder],
        "index": [folder.parent],
        "import": [folder / "points.csv", folder / "arm.csv", "--to", inside / "new"],
    }
    run_commands(commands, inside)


@fuzzed(60)
@given(data=st.data())
def test_mutated_tables_of_a_dataset_crash_no_command(tables, sandbox, data):
    inside = sandbox()
    folder = inside / "data"
    folder.mkdir()
    for name, text in tables.items():
        (folder / name).write_text(text)
    name = data.draw(st.sampled_from(list(tables)))
    if name == "dataset.yaml":
        document = yaml.safe_load(tables[name])
        content = yaml.safe_dump(data.draw(damaged_document(document))).encode()
        if data.draw(st.integers(0, 2)) == 0:
            content = data.draw(damaged_bytes(tables[name].encode()))
    else:
        content = data.draw(damaged_csv(tables[name]))
    (folder / name).write_bytes(content)
    look_at(folder, inside)


@fuzzed(80)
@given(data=st.data())
def test_mutated_parquet_tables_of_a_dataset_crash_no_command(sandbox, data):
    inside = sandbox()
    folder = shutil.copytree(ROOT / "data/sample", inside / "data")
    file = folder / data.draw(st.sampled_from(["points.parquet", "arm.parquet"]))
    file.write_bytes(data.draw(damaged_bytes(file.read_bytes())))
    run_guarded(load_command("check"), [str(folder)], inside)


@fuzzed(80)
@given(data=st.data())
def test_mutated_files_to_import_crash_no_command(sandbox, data):
    inside = sandbox()
    names = ["robot_1.csv", "tracker_1.csv", "robot_2.csv", "tracker_2.csv"]
    for name in names:
        shutil.copy(ROOT / "data/tutorial" / name, inside)
    name = data.draw(st.sampled_from(names))
    content = data.draw(damaged_csv((inside / name).read_text()))
    (inside / name).write_bytes(content)
    words = [*(str(inside / name) for name in names), "--to", str(inside / "mine")]
    words += data.draw(st.sampled_from([[], GEOMETRY, [*GEOMETRY, "--clock", "fit"]]))
    run_guarded(load_command("import"), words, inside)


@pytest.fixture(scope="module")
def bag():
    """Return the bytes of a small bag, uncompressed so that damage is read."""
    needs = "needs: pip install mcap mcap-ros2-support"
    writer = pytest.importorskip("mcap_ros2.writer", reason=needs)
    compression = pytest.importorskip("mcap.writer", reason=needs).CompressionType
    file = io.BytesIO()
    made = writer.Writer(file, compression=compression.NONE, enable_crcs=False)
    state = made.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
    point = made.register_msgdef("geometry_msgs/msg/PointStamped", POINT)
    for n in range(FRAMES):
        stamp = {"sec": 1_700_000_000, "nanosec": n * 10_000_000}
        header = {"stamp": stamp, "frame_id": ""}
        angles = {"name": ["a1", "a2", "a3"], "position": [0.1 * n, 0.3, 0.4]}
        made.write_message(
            "/joint_states",
            state,
            {"header": header, "velocity": [], "effort": [], **angles},
        )
        place = {"x": 0.1 * n, "y": 9.0, "z": 0.5}
        made.write_message("/tip", point, {"header": header, "point": place})
    made.finish()
    return file.getvalue()


@fuzzed(150)
@given(data=st.data())
def test_mutated_recordings_of_ros_crash_no_command(bag, sandbox, data):
    inside = sandbox()
    file = inside / "bag.mcap"
    file.write_bytes(data.draw(damaged_bytes(bag)))
    words = [str(file), "--plane", "x,z", "--to", str(inside / "mine")]
    run_guarded(load_command("import"), words, inside)
