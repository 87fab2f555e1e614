"""Messages of a running sweep, and stored files of runs."""

from types import SimpleNamespace

import pandas as pd
import pytest

from stringcast.data import dataset
from stringcast.data.artifacts import ARM, FRAMES, LINK, POINTS, TICKS, Trial
from stringcast.data.images import encode_png
from stringcast.data.store import write_table, write_text
from stringcast.data.table_files import with_trial
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.experiment import SAVEABLE_OUTPUTS, check_run_settings
from stringcast.pipeline.run.iterations import Iteration
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.sweep.launcher import remaining_time
from tests.experiments import resolve_settings


def test_remaining_time_follows_the_pace_so_far():
    assert remaining_time(60.0, waiting=9, of=12) == "(9 left, about 0:03:00)"
    assert remaining_time(60.0, waiting=0, of=12) == ""


def on(lab):
    return SimpleNamespace(config={"hardware": {"_target_": lab}})


def test_run_without_frames_is_a_dataset(tmp_path):
    place = tmp_path / "iterations" / "01" / "trial" / "images"
    place.mkdir(parents=True)
    t = [0.0, 0.1, 0.2]
    files = [f"iterations/01/trial/images/{i}.png" for i in range(3)]
    for file in files:
        (tmp_path / file).write_bytes(
            encode_png(pd.DataFrame([[0, 1], [2, 3]]).to_numpy("uint8"))
        )
    tables = {
        ARM: {"t": t, "q1": t, "q2": t, "q3": t},
        FRAMES: {"frame": [0, 1, 2], "t": t, "file": files},
        POINTS: {"t": t, "s": [0.0, 0.1, 0.2], "x": t, "y": t},
    }
    for table, columns in tables.items():
        frame = pd.DataFrame(columns).assign(trial="t01")
        write_table(with_trial(table), frame, tmp_path / f"{table.name}.parquet", {})
    write_text(tmp_path / "dataset.yaml", "format: 1\nstring: {length: 0.3}\n")
    assert dataset.read_dataset(tmp_path).films
    names = [f"images/{i}.png" for i in range(3)]
    frames = pd.DataFrame({"file": names})
    trial = Trial(ARM.empty(), TICKS.empty(), frames, LINK.empty(), [])
    ended = RunResult(tmp_path, (Iteration(1, {"trial": trial}),), "")
    other = place.with_name("not_of_the_run")
    other.mkdir()
    run_folder.remove_frames(on("hardware.serial.lab.open_lab"), ended)
    assert place.exists()  # a real film cannot be repeated
    run_folder.remove_frames(on("hardware.virtual.open_lab"), ended)
    assert not place.exists()
    assert other.exists()  # the trial's table does not name this folder
    again = dataset.read_dataset(tmp_path)
    assert not again.films
    assert len(again.trials["t01"].points) == 3


def test_unknown_saved_outputs_are_refused():
    config = resolve_settings()
    assert config["saved_outputs"] == list(SAVEABLE_OUTPUTS)
    for wrong in (["pictures"], "frames"):
        with pytest.raises(
            UserError, match=r"saved_outputs = .*\[?.*frames, report\. Change it"
        ):
            check_run_settings(
                config | {"saved_outputs": wrong}, lambda block: "conf/config.yaml"
            )
