"""Texts of the files that the command `new` writes.

`{name}`, `{Name}` (of a class) and `{plugin}` (the folder) are filled in.
"""

EFFECT_TEMPLATE = '''\
"""Describe the cause in a line: here the whole string is pulled to the right."""

from stringcast.stages.model.effect import (
    Parameter,
    Quantity,
    StringEffect,
    Values,
    vanishes_at_zero,
)


class {Name}(StringEffect):
    """Describe the law, where it holds and what it leaves out."""

    name = "{name}"
    # name, unit, meaning, bounds, and the start, where the effect is absent
    parameters = (
        Parameter("strength", "m/s2", "pull to the right, over mass", -2.0, 2.0, 0.0),
    )
    reference = "Source of the law"
    # tested; see invariants.py
    invariants = (vanishes_at_zero("acceleration", "strength"),)

    @staticmethod
    def describe(values: Values) -> str:
        return f"the string is pulled to the right with {{values['strength']:.3f}} m/s2"

    # a slot of law_slots.py
    @staticmethod
    def acceleration(strength: Quantity) -> tuple[Quantity, Quantity]:
        return strength, 0.0 * strength
'''
STAGE_TEMPLATE = '''\
"""{Name}: the largest distance of each trial's tip from its start."""

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from stringcast.data.artifacts import Points
from stringcast.data.schema import Column, Table
from stringcast.stages.spec import CollectedTrials, StageSpec, StageSummary

FARTHEST = Table(
    "farthest",
    "a row for each trial",
    (
        Column("trial", "", "name of the trial", "text"),
        Column("sway", "m", "largest distance of the tip from its start"),
    ),
)


@dataclass(frozen=True)
class {Name}:
    """Artifact of the stage, with a field for each table."""

    farthest: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {{"farthest": FARTHEST}}


def summary(artifact: {Name}) -> StageSummary:
    """Summarise the artifact for the terminal."""
    farthest = artifact.farthest
    sentence = f"The tip moves by at most {{farthest['sway'].max():.3f}} m."
    return StageSummary("{name}", sentence, farthest.round(3))


STAGE = StageSpec(
    name="{name}",  # also of its group of settings
    makes={Name},
    folder="{name}",  # of the artifact in an iteration
    uses=("{name}",),  # settings that change the artifact
    run="plugins.{plugin}.stages.{name}.{name}.run",  # makes the artifact
    inputs={{"trials": CollectedTrials(parts={{"points": Points}})}},
    is_end=True,  # its artifact is a result by itself
    # allowed as `_target_` in conf/{name}/*.yaml
    by=("plugins.{plugin}.stages.{name}.{name}.{name}",),
    summary=summary,
)
'''
FUNCTION_TEMPLATE = '''\
"""Measure how far the tip moves."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.stages.common import Progress
from stringcast.stages.spec import StageCall

from . import FARTHEST, {Name}


def run(call: StageCall, trials: TrialSet) -> {Name}:
    """Run the stage on all trials."""
    artifact: {Name} = call.by(trials.observations, progress=call.progress)
    return artifact


def {name}(
    observations: Sequence[Observation],
    *,
    least: Annotated[float, Field(ge=0)],
    progress: Progress = lambda share: None,
) -> {Name}:
    """Measure the largest distance of each tip from its start, from `least` on [m].

    The function is pure: artifacts are positional arguments, settings are keywords.
    """
    rows = []
    for trial in observations:
        points = trial.valid_points
        tip = points[points["s"] == points["s"].max()]
        x, y = tip["x"] - tip["x"].iloc[0], tip["y"] - tip["y"].iloc[0]
        distance = np.hypot(x, y).max()
        if distance > least:
            rows.append({{"trial": trial.trial, "sway": distance}})
    return {Name}(FARTHEST.check(pd.DataFrame(rows)))
'''
SETTINGS_TEMPLATE = """\
# Settings of the stage; each is a keyword of the function.
_target_: plugins.{plugin}.stages.{name}.{name}.{name}
least: 0.0   # smallest distance that is listed [m]
"""
ESTIMATOR_TEMPLATE = '''\
"""Estimate by the best of strings that are drawn uniformly from the whole range."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from stringcast.data.artifacts import Observation
from stringcast.data.estimates import Estimate
from stringcast.stages.common import Progress
from stringcast.stages.estimate.matching import (
    Matching,
    matching_rate,
    matching_targets,
)
from stringcast.stages.estimate.result import (
    Candidates,
    build_search_estimate,
    start_chi,
)
from stringcast.stages.model.model import Model


def estimate(
    model: Model,
    observations: Sequence[Observation],
    previous: Estimate | None,
    *,
    seed: int,
    cast_number: int,
    candidates: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Search for the highest matching rate among uniform candidates.

    Arguments after `*` are settings, except for those that a run supplies: `seed`,
    `cast_number` (the number of the cast, from 1) and `progress`.
    """
    targets = matching_targets(model, observations, matching)
    before = start_chi(model, previous)  # exponents (P,) in [0, 1]
    rng = np.random.default_rng([seed, cast_number])
    chi = rng.uniform(0, 1, (candidates, len(before)))
    search = Candidates("{name}", chi, matching_rate(targets, chi))
    return build_search_estimate(targets, before, search, seed)
'''
ESTIMATOR_SETTINGS_TEMPLATE = """\
# The best of strings drawn uniformly from the whole range.
_target_: plugins.{plugin}.estimate.{name}.estimate
candidates: 500  # strings that are compared
matching:
  dilations: 20  # p_max in the paper
  step_px: 2  # growth in one dilation [px]
  tip_step_px: 3.0  # tip distance that costs one score [px]
  delta_w: 0.25  # weight added per point, Eq. 6
"""
