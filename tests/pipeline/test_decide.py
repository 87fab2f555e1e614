"""The experiment `decide` performs proposed motions and diagnoses again.

A fake diagnosis proposes a swing until one was performed, as only the orchestration is
tested.
"""

import json
import shutil
from dataclasses import replace

import pandas as pd
import pytest

from stringcast.data.artifacts import Motion
from stringcast.data.diagnoses import Diagnosis
from stringcast.data.store import content_hash, load, read_origin
from stringcast.pipeline.run import run_folder
from stringcast.pipeline.run.result import run_summary
from tests.conftest import swing
from tests.faults.toy import silent
from tests.pipeline.small import about

SEEN = []  # trial names of each diagnosis


def proposing(model, observations, rejected, held_out, obstacles, *, seed, progress):
    """Return a diagnosis that proposes a swing until one was performed."""
    SEEN.append([o.trial for o in observations])
    wanted = not any(o.trial.startswith("performed") for o in observations)
    text = {
        "verdict": "ambiguous" if wanted else "effect",
        "interrupted": False,
        "causes": [],
        "trials": {"rejected": {**rejected, "t99": "no light"}},
    }
    text["next_experiment"] = (
        {"sentence": "Swing.", "between": ["a", "b"]} if wanted else None
    )
    row = {
        "verdict": text["verdict"],
        "sentence": "So.",
        "diagnosis": json.dumps(text),
        "extended": "effects: []",
    }
    tables = {name: table.empty() for name, table in Diagnosis.TABLES.items()} | {
        "finding": pd.DataFrame([row])
    }
    if wanted:
        string = pd.DataFrame(
            {
                "hypothesis": ["a"],
                "t": [0.0],
                "s": [0.1],
                "x": [0.0],
                "y": [0.0],
                "sigma": [1e-3],
            }
        )
        tables |= {"commands": swing(duration=0.2).commands, "predicted": string}
    return Diagnosis(**tables)


@pytest.fixture(autouse=True, scope="module")
def clocks_are_together():
    """Skip the test of clocks, which takes 5 s."""
    place = "stringcast.pipeline.modes.diagnose.refuse_unlike_clocks"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(place, lambda *given: None)
        yield


def decide(trials, folder, experiment="decide", diagnose=proposing):
    here = about(trials, f"+experiment={experiment}")
    SEEN.clear()
    here = replace(here, stages={**here.stages, "diagnose": diagnose})
    result = here.mode.run_steps(
        here,
        folder,
        run_folder.RunFolder(here, folder, here.mode.graph(here.config), silent, print),
    )
    run_folder.write_stage_files(result)
    return result


@pytest.fixture(scope="module")
def decided(sample_trial, tmp_path_factory):
    """Decide once; return the result and the trials that each diagnosis saw."""
    result = decide(sample_trial, tmp_path_factory.mktemp("decided"))
    return result, list(SEEN)


def test_proposed_motion_is_performed_and_its_trial_diagnosed(decided):
    result, (first, second) = decided
    assert second == [*first, f"performed-{len(first) + 1:02d}"]
    place = result.folder / "iterations" / f"{len(first) + 1:02d}"
    assert {p.name for p in place.iterdir()} == {
        "motion",
        "trial",
        "points",
        "diagnosis",
    }
    assert result.final_artifact.verdict == "effect"
    document = json.loads((result.folder / "diagnosis.json").read_text())
    assert document["next_experiment"] is None
    # the motion had no target
    assert "hit" not in run_summary(result)
    points = pd.read_parquet(result.folder / "points.parquet")
    assert set(points["trial"]) == {second[-1]}
    sources = read_origin(place / "diagnosis" / "finding.parquet")["inputs"]
    trial = place.relative_to(result.folder) / "points"
    assert sources[trial.as_posix()] == content_hash(result.folder / trial)


def test_interrupted_decision_continues_without_repeating_steps(
    decided, sample_trial, tmp_path
):
    result, _ = decided
    run = shutil.copytree(result.folder, tmp_path / "run")
    last = sorted((run / "iterations").iterdir())[-1]
    for name in ("points", "diagnosis"):
        shutil.rmtree(last / name)
    decide(sample_trial, run)
    assert len(SEEN) == 1  # the first diagnosis was read, not repeated
    whole = content_hash(result.folder / "iterations")
    assert content_hash(run / "iterations") == whole


def test_plain_diagnosis_proposes_a_motion_without_performing_it(
    sample_trial, tmp_path
):
    result = decide(sample_trial, tmp_path, "diagnose")
    proposal = json.loads((tmp_path / "diagnosis.json").read_text())["next_experiment"]
    motion = load(Motion, tmp_path / proposal["motion"])
    assert motion.duration == pytest.approx(0.2)
    assert not list((tmp_path / "iterations").rglob("trial"))
    assert result.sentence == "So. Swing."
