"""Strings that others measured.

They are read as their authors describe them, fitted as a person would by hand, and
counted once.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf

from stringcast.data.dataset import read_dataset
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    given_names,
)
from stringcast.pipeline.settings.settings_from_runs import inherit_settings
from stringcast.pipeline.settings.typed_settings import build_dataclass
from tests.benchmarks.measured.scores import SETS
from tests.benchmarks.measured.strings import families_with_all_trials
from tests.benchmarks.measured.study import (
    WHERE,
    FitJob,
    MeasuredSettings,
    MeasuredStudy,
    fit_settings,
)
from tests.benchmarks.study import run_study, study_settings

MEASURED = Path(__file__).resolve().parents[4] / "shared" / "measured"


def measured_settings():
    return build_dataclass(
        MeasuredSettings,
        study_settings("measured", ["measured.source=."])["measured"],
        "measured",
        WHERE,
    ).families


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured sets are not here")
def test_every_string_is_read_with_all_its_trials(tmp_path):
    weighed = json.loads((MEASURED / "tudelft_cable_fr3" / "cables.json").read_text())
    assert (
        sum(
            len(trials)
            for f in families_with_all_trials()
            for trials in f.trials_by_string(MEASURED).values()
        )
        == 28
    )
    seen = {}
    for family in measured_settings().values():
        for name, trials in family.trials_by_string(MEASURED).items():
            family.write(MEASURED, name, trials, tmp_path / name, {})
            found = read_dataset(tmp_path / name)
            assert sorted(found.trials) == trials
            assert not found.rejection_reasons
            length = weighed[name]["L_m"] if name in weighed else 1e-3 * int(name[:-2])
            assert found.metadata["string"]["length"] == pytest.approx(length, abs=1e-4)
            moving = {
                trial: stored.starts_moving for trial, stored in found.trials.items()
            }
            assert moving == {trial: not trial.startswith("drive") for trial in trials}
            seen |= {
                trial: said.get("role")
                for trial, said in found.metadata["trials"].items()
            }
    aside = {trial for trial, role in seen.items() if role == "held_out"}
    assert aside == {t for t in seen if t.startswith("drive")} | {
        "75mm_2",
        "75mm_4",
        "100mm_2",
        "100mm_4",
    }


def write_cable(folder):
    """Write a cable as the study finds it: released, and shaken by the hand."""
    t = np.arange(0, 0.6, 1 / 30)
    tables = {"grasp": [], "points": []}
    for trial in ("release_red", "drive_red"):
        x = 0.0 if trial.startswith("release") else 0.02 * np.sin(t)  # no swing
        tables["grasp"].append(
            pd.DataFrame(
                {
                    "trial": trial,
                    "t": t,
                    "x": x,
                    "y": 0.0,
                    "theta": -np.pi / 2,
                    "fx": 1.0,
                }
            )
        )
        for s in (0.1, 0.2):
            swing = (
                0.0
                if trial.startswith("drive")
                else 0.05 * (s / 0.2) ** 1.5 * np.cos(12 * t) * np.exp(-2 * t)
            )
            held = t > 0.55
            tables["points"].append(
                pd.DataFrame(
                    {
                        "trial": trial,
                        "t": t,
                        "s": s,
                        "x": x + swing,
                        "y": -s,
                        "held": held,
                    }
                )
            )
    (folder / "tudelft_cable_fr3").mkdir()
    for table, frames in tables.items():
        pd.concat(frames).to_parquet(
            folder / "tudelft_cable_fr3" / f"{table}.parquet", index=False
        )
    (folder / "tudelft_cable_fr3" / "cables.json").write_text(
        '{"red": {"m_cable_kg": 0.2, "m_tip_kg": 0.01}}'
    )


@pytest.fixture
def config(tmp_path):
    """Return settings of a study of one string with rough, quick fits."""
    source = tmp_path / "source"
    source.mkdir()
    write_cable(source)
    place = "measured.families.cables.settings"
    less = [
        f"{place}.estimate.{name}=1" for name in ("starts", "screening", "iterations")
    ]
    less += [
        f"{place}.string.points=6",
        f"{place}.string.largest_step=2e-3",
        "measured.strings=[red]",
    ]
    found = study_settings("measured", [f"measured.source={source}", *less])
    found["measured"]["families"] = {"cables": found["measured"]["families"]["cables"]}
    found["measured"]["families"]["cables"]["sets"] = {
        "viscous": {"effects": ["rest_curvature"]}
    }
    return found


def test_a_set_is_fitted_as_a_person_would_do_it_by_hand(config, tmp_path):
    """A fit of the study equals a fit by hand with the same settings."""
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "dataset.yaml").write_text(
        "format: 1\nstring: {length: 0.2, mass: 0.2, tip_mass: 0.01}\n"
    )
    by_hand = [
        "+experiment=estimate",
        f"trials={tmp_path / 'dataset'}",
        "string=cable",
        "estimate=least_squares",
    ]
    by_hand += [
        "effects=[rest_curvature]",
        "effects_per_recording=[rest_curvature]",
        "trials_used=all",
        "saved_outputs=[]",
    ]
    by_hand += ["string.points=6", "string.largest_step=2e-3"]
    by_hand += [f"estimate.{name}=1" for name in ("starts", "screening", "iterations")]
    person = inherit_settings(
        OmegaConf.create(compose_settings(by_hand)), given_names(by_hand)
    )
    assert (
        fit_settings(
            FitJob("cables", "red", "viscous", config, tmp_path), tmp_path / "dataset"
        )
        == person
    )


def test_a_study_counts_what_was_fitted_and_what_was_predicted(
    config, tmp_path, monkeypatch
):
    """A study counts fitted and predicted trials, and repeats no existing run."""
    folder = tmp_path / "study"
    quick = compose_settings(["estimate=random_search"])["estimate"] | {
        "candidates": 8,
        "batch": 8,
    }
    config["measured"]["families"]["cables"]["settings"]["estimate"] = quick
    monkeypatch.setattr("tests.benchmarks.study.worker_pool", Here)
    sentence = run_study(MeasuredStudy(), config, folder, lambda share: None)
    assert sentence.startswith("1 sets of effects on 1 strings")
    row = SETS.check(pd.read_parquet(folder / "sets.parquet")).iloc[0]
    said = json.loads((folder / "fits" / "red-viscous" / "run.json").read_text())[
        "iterations"
    ]
    assert (row["tip"], row["rms"]) == (said[0]["tip_rms_m"], said[0]["rms_m"])
    assert (row["held_out_tip"], said[1]["held_out"]) == (
        pytest.approx(said[1]["tip_rms_m"]),
        "drive_red",
    )
    # Eight parameters of the paper and two of the set; the tip was weighed. Six modes
    # of a shape and of its rates of turning.
    assert row[["trials", "fitted", "initial", "held_out", "free"]].tolist() == [
        1,
        10,
        12,
        1,
        2,
    ]
    assert row["cpu"] > 0
    assert np.isnan(row["authors_tip"])
    assert (folder / "sets.png").stat().st_size > 1000
    monkeypatch.setattr("tests.benchmarks.measured.study.perform_run", None)
    assert run_study(MeasuredStudy(), config, folder, lambda share: None) == sentence


class Here:
    """Workers that are the calling process."""

    def __init__(self, processes, lives):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, function, *arguments):
        from concurrent.futures import Future

        future = Future()
        future.set_result(function(*arguments))
        return future


def test_a_string_that_is_not_there_is_named(config, tmp_path):
    config["measured"]["strings"] = ["green"]
    with pytest.raises(UserError, match="there is no green; there are red"):
        MeasuredStudy().jobs(config, tmp_path)
