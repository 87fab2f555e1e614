"""A whole run with the arm disabled: every step but estimation, and its trial is refused wherever it is read."""

import json
import re
import subprocess
import sys

import yaml

REASON = "rehearsal with the arm disabled"


def test_nothing_is_learned_from_a_rehearsal(tmp_path):
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "pipeline", "+experiment=quick", "execute=dry", f"hydra.run.dir={folder}"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert ran.returncode == 0, ran.stderr
    said = " ".join(ran.stderr.replace("│", " ").split())
    assert REASON in said
    assert "nan" not in said
    sentence = json.loads((folder / "run.json").read_text())["sentence"]
    assert re.match(r"Rehearsed: .*commands went out 0\.00 ms late .* 0 of \d+ were late or lost", sentence)
    read, frames = map(int, re.search(r"the string was read in (\d+) of (\d+) frames", sentence).groups())
    assert 0.9 * frames < read <= frames
    assert {path.name for path in (folder / "iterations/01").iterdir()} == {"motion", "trial", "points"}
    assert (folder / "report.html").exists()
    assert yaml.safe_load((folder / "dataset.yaml").read_text())["trials"] == {"t01": {"invalid": REASON}}
    data = read(folder)
    assert data.trials == {}
    assert data.rejected == {"t01": REASON}
