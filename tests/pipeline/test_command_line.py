"""The command as a user gives it: runs, resumes, estimates again, sweeps, and refuses clearly."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = sorted(p.stem for p in (ROOT / "conf" / "experiment").glob("*.yaml"))


def pipeline(*overrides, folder=None, limit=300):
    where = [f"hydra.run.dir={folder}"] if folder else []
    command = [sys.executable, "-m", "pipeline", *overrides, *where]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=limit, check=False)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """A finished smoke run."""
    folder = tmp_path_factory.mktemp("runs") / "quick"
    done = pipeline("+experiment=quick", "manipulations=2", folder=folder)
    assert done.returncode == 0, done.stderr
    return folder


def tables(folder):
    return {str(p.relative_to(folder)): pd.read_parquet(p) for p in sorted(folder.rglob("*.parquet"))}


def same(a, b):
    assert a.keys() == b.keys()
    for name in a:
        pd.testing.assert_frame_equal(a[name], b[name], check_exact=True, obj=name)


def test_a_run_leaves_everything_on_disk(quick):
    ended = json.loads((quick / "run.json").read_text())
    assert ended["sentence"]
    assert {p.name for p in (quick / "iterations" / "01").iterdir()} == {"motion", "trial", "points", "estimate"}
    assert (quick / "dataset.yaml").exists()
    page = (quick / "report.html").read_text()
    assert 'src="http' not in page
    assert page.count("<img alt=") >= 7
    assert ended["sentence"] in page


def test_an_interrupted_run_goes_on_to_the_same_result(quick, tmp_path):
    """As if killed in the middle: later artifacts gone, one half-written aside."""
    part = tmp_path / "part"
    shutil.copytree(quick, part)
    shutil.rmtree(part / "iterations" / "01" / "estimate")
    shutil.rmtree(part / "iterations" / "02", ignore_errors=True)
    (part / "iterations" / "01" / ".estimate.0123.part").mkdir()
    (part / "run.json").unlink()
    assert pipeline("+experiment=quick", "manipulations=2", folder=part).returncode == 0
    same(tables(part), tables(quick))
    other = pipeline("+experiment=quick", "manipulations=2", "seed=9", folder=part)
    assert other.returncode == 1
    assert "other settings" in other.stderr


def test_estimation_again_from_stored_trials_is_bit_identical(quick, tmp_path):
    again = pipeline("+experiment=estimate", f"trials={quick}", folder=tmp_path / "again")
    assert again.returncode == 0, again.stderr
    for number in ("01", "02"):
        first = quick / "iterations" / number / "estimate"
        if first.exists():
            same(tables(first), tables(tmp_path / "again" / "iterations" / number / "estimate"))


def test_points_are_made_of_frames_where_only_frames_were_stored(quick, tmp_path):
    """Somebody's dataset of pictures and joint angles: the same pictures give the same points."""
    theirs = tmp_path / "theirs"
    for file in ("arm.parquet", "frames.parquet", "dataset.yaml"):
        theirs.mkdir(exist_ok=True)
        shutil.copy(quick / file, theirs)
    shutil.copytree(quick / "iterations/01/trial", theirs / "iterations/01/trial")
    done = pipeline("+experiment=estimate", f"trials={theirs}", "estimate.candidates=40", folder=tmp_path / "run")
    assert done.returncode == 0, done.stderr
    same(tables(quick / "iterations/01/points"), tables(tmp_path / "run/iterations/01/points"))
    about = theirs / "dataset.yaml"
    about.write_text(about.read_text().replace("px_per_m", "per_m"))
    refused = pipeline("+experiment=estimate", f"trials={theirs}", folder=tmp_path / "other")
    assert refused.returncode == 1
    assert "camera.px_per_m must be there" in refused.stderr.replace("\n", " ")


def test_a_sweep_runs_every_job(tmp_path):
    swept = pipeline(
        "--multirun", "+experiment=quick", "seed=0,1", "estimate.candidates=40", f"hydra.sweep.dir={tmp_path}"
    )
    assert swept.returncode == 0, swept.stderr
    assert {p.parent.name for p in tmp_path.rglob("run.json")} == {"0", "1"}
    whole = pd.read_parquet(tmp_path / "sweep.parquet")
    assert len(whole) == 2
    assert set(whole["seed"]) == {"0", "1"}
    assert {"hit", "manipulations", "E_after"} <= set(whole)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["estimate.bta=1"], "Did you mean 'estimate.beta'"),
        (["+estimate.bta=1"], "Did you mean 'beta'"),
        (["estimate.beta=1.5"], "estimate.beta = 1.5 .*random_search.yaml"),
        (["estimate.beta=abc"], "valid number"),
        (["camera.fps=-3"], "camera.fps"),
        (["target.x=2"], "out of reach"),
        (["string.points=2"], "from 3 to"),
        (["string.ranges.axial_stiffness.low=1e9"], "must be below"),
        (["+experiment=estimate", "trials=/nonexistent"], "no such folder"),
        (["+experiment=strinB"], "stringB"),
        (["hardwear=virtual"], "Did you mean 'hardware'"),
        (["hydra.run.dir=/proc/nope"], "cannot be written"),
        (["hardware=serial", "hardware.port=/dev/nowhere", "generate.longest=0.4"], "hardware"),
    ],
)
def test_bad_input_is_one_clear_error(overrides, words, tmp_path):
    import re

    place = [] if any("run.dir" in o for o in overrides) else [f"hydra.run.dir={tmp_path / 'run'}"]
    refused = pipeline(*overrides, *place)
    assert refused.returncode != 0
    assert "Traceback" not in refused.stderr
    assert re.search(words, refused.stderr.replace("\n", " "))
    if "hardware=serial" not in overrides:
        assert not (tmp_path / "run").exists() or not any((tmp_path / "run").iterdir())


def test_a_damaged_trial_is_named(quick, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(quick, broken)
    file = broken / "points.parquet"
    file.write_bytes(file.read_bytes()[:-20])
    refused = pipeline("+experiment=estimate", f"trials={broken}", folder=tmp_path / "run")
    assert refused.returncode == 1
    assert "points.parquet" in refused.stderr.replace("\n", "")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_composes_and_is_valid(name, monkeypatch):
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    from pipeline.world import world

    monkeypatch.setitem(os.environ, "HYDRA_FULL_ERROR", "1")
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        config = compose("config", [f"+experiment={name}"])
    settings = OmegaConf.to_container(config, resolve=True)
    here = world(settings, lambda block: f"conf/{block}")
    assert here.string.points == (25 if name == "stringD" else 10)


def test_help_helps():
    shown = pipeline("--help")
    assert shown.returncode == 0
    assert "+experiment=stringB" in shown.stdout
    assert "trials=" in shown.stdout
