"""Alignment from the command line, and its use by other experiments."""

from pathlib import Path

import pandas as pd
import pytest
import yaml

from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.settings_from_runs import read_extended_model
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from tests.alignment.stand import MISALIGNMENT, build_bench
from tests.experiments import resolve_settings

ROOT = Path(__file__).resolve().parents[2]
MEASURED = {"time_offset.offset": {"value": 0.012, "low": 0.0119, "high": 0.0122}}


def experiment_with(parameter_values, effects=("time_offset",)):
    known = {"effects": list(effects), "parameter_values": parameter_values}
    return prepare_experiment(resolve_settings() | known, lambda block: f"conf/{block}")


def test_measured_interval_limits_the_search():
    parameter = experiment_with(MEASURED).model.parameters[-1]
    assert (parameter.name, parameter.start, parameter.low, parameter.high) == (
        "time_offset.offset",
        0.012,
        0.0119,
        0.0122,
    )
    plain = experiment_with({"time_offset.offset": 0.012}).model.parameters[-1]
    assert (plain.start, plain.low, plain.high) == (0.012, -0.05, 0.05)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"value": 0.012, "low": 0.013, "high": 0.014}, "must enclose value"),
        ({"value": 0.012, "low": 0.01}, "it must be a number, or value, low and high"),
        (
            {"value": "soon", "low": 0.0, "high": 0.1},
            "time_offset.offset.value = 'soon' .*: it must be a number",
        ),
    ],
)
def test_invalid_range_is_refused(setting, message):
    with pytest.raises(UserError, match=message):
        experiment_with({"time_offset.offset": setting})


def test_alignment_of_stored_points_is_used_by_the_next_experiment(
    arm, camera, called, undrawn, tmp_path
):
    bench = build_bench(Model(String(0.3), arm, camera))
    seen = bench.observation(MISALIGNMENT)
    trials = tmp_path / "trials"
    trials.mkdir()
    for name, table in (("arm", seen.arm), ("points", seen.points)):
        pd.DataFrame(table).assign(trial="t01").to_parquet(trials / f"{name}.parquet")
    about = {"format": 1, "name": "swing", "string": {"length": 0.3}}
    about["arm"] = {"links": list(arm.links), "base": list(arm.base)}
    (trials / "dataset.yaml").write_text(yaml.safe_dump(about))
    result = called(
        "+experiment=align", f"trials={trials}", f"hydra.run.dir={tmp_path / 'run'}"
    )
    assert result.returncode == 0, result.stderr
    settings = read_extended_model(tmp_path / "run")
    model = experiment_with(**settings).model
    assert set(model.measured_ranges) == set(MISALIGNMENT)
    for name, value in MISALIGNMENT.items():
        low, high = model.measured_ranges[name]
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low), name
    assert "would look the same" in (tmp_path / "run" / "report.html").read_text()
