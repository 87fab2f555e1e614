"""The example of the page on writing an estimator works."""

import re
from pathlib import Path

import numpy as np
from estimation.test_estimate import MATCHING, STRING, simulate_swing

from stringcast.stages.model.model import Model

PAGE = Path(__file__).resolve().parents[2] / "stages/estimate/writing_an_estimator.md"


def test_estimator_of_the_page_finds_a_better_string(arm, camera):
    code = re.search(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S)[1]
    namespace = {}
    exec(compile(code, str(PAGE), "exec"), namespace)
    observation = simulate_swing(2)
    result = namespace["estimate"](
        Model(STRING, arm, camera),
        [observation],
        None,
        seed=1,
        cast_number=1,
        progress=None,
        candidates=32,
        matching=MATCHING,
    )
    fit = result.fit.iloc[0]
    assert fit["method"] == "uniform search"
    assert len(result.candidates) == 32
    assert np.isfinite(fit["after"])
    assert fit["after"] > fit["before"] - 1e-12 or fit["rejected"] > 0
