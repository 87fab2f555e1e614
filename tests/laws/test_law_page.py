"""The page on how to write a law, whose code is run as it is printed."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from stringcast.stages.model import effects
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import HandMotion
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.string import PAPER_EFFECTS, String

PAGE = Path(effects.__file__).with_name("README.md")
MAX_LINES = 50


def test_the_example_on_the_page_runs_and_is_absent_at_its_start(effects_folder):
    page = PAGE.read_text()
    assert len(page.splitlines()) <= MAX_LINES
    (source,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (effects_folder / "side_pull.py").write_text(source)
    effect = effects_by_name()["side_pull"]

    plain = String(0.3)
    # without the last of the paper's forces, so the loop is small and compiles quickly
    pulled = replace(plain, effects=(*PAPER_EFFECTS[:-1], effect))
    poses = np.zeros((1, 41, 3))
    poses[..., 1:] = 1.0, -np.pi / 2
    hand = HandMotion(0.0, 0.005, poses, np.zeros_like(poses))
    times = np.array([0.2])

    def tip(string: String, named: dict[str, float]) -> np.ndarray:
        return simulate(string, hand, string.values(named), times).tip

    np.testing.assert_array_equal(tip(pulled, {}), tip(plain, {"grasp_damping": 0.0}))
    assert np.all(tip(pulled, {"side_pull.strength": 2.0})[..., 0] > 0.01)
