"""Write a working start of an arm, camera, effect, estimator or stage of your own."""

from __future__ import annotations

import keyword
import re
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path

from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import CONF_FOLDER, UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import NAME_PATTERN

DEFAULT_PLUGIN = Path("my_lab")
# Where a name is taken by the package.
PACKAGE_PLACES = {
    "arm": ("conf/arm/{}.yaml",),
    "camera": ("conf/camera/{}.yaml",),
    "effect": ("stages/model/effects/{}.py",),
    "estimator": ("conf/estimate/{}.yaml",),
    "stage": ("stages/{}", "conf/{}"),
}
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

from stringcast.data.artifacts import Estimate, Observation
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
    manipulation: int,
    candidates: Annotated[int, Field(ge=1)],
    matching: Matching,
    progress: Progress = lambda share: None,
) -> Estimate:
    """Search the highest matching rate among uniform candidates.

    Arguments after `*` are settings, except for those that a run supplies: `seed`,
    `manipulation` (the number of the cast, from 1) and `progress`.
    """
    targets = matching_targets(model, observations, matching)
    before = start_chi(model, previous)  # exponents (P,) in [0, 1]
    rng = np.random.default_rng([seed, manipulation])
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


def main(arguments: Sequence[str]) -> int:
    """Write the files and return the exit status 0."""
    parser = CommandParser("python -m pipeline new", description=__doc__)
    parser.add_argument("kind", choices=list(FILES_OF_KIND), help="what to write")
    parser.add_argument("name", help="name of small letters, digits and _")
    parser.add_argument(
        "--to",
        type=Path,
        default=DEFAULT_PLUGIN,
        help="your folder, made if need be; by default my_lab in the current folder",
    )
    options = parser.parse_args(arguments)
    kind: str = options.kind
    name: str = options.name
    plugin: Path = options.to.resolve()
    refuse_odd_names(kind, name, plugin)
    texts, example = FILES_OF_KIND[kind](name, plugin.name)
    files = {plugin / path: text for path, text in texts.items()}
    refuse_taken_name(kind, name, list(files))
    for file, text in files.items():
        write_text(file, text)
    console = Terminal()
    for file in files:
        console.print_line(f"Written: {shown_path(file)}")
    setting = shlex.quote(f"plugins=[{shown_path(plugin)}]")
    console.print_line(f"Try it: {program_name()} {setting} {example}")
    return 0


def refuse_odd_names(kind: str, name: str, plugin: Path) -> None:
    """Raise UserError if a module cannot have the name, or that of the folder."""
    for given in (name, plugin.name):
        if not is_module_name(given):
            near = nearest_module_name(name)
            folder = shown_path(plugin.with_name(nearest_module_name(plugin.name)))
            command = ["new", kind, near, "--to", str(folder)]
            raise UserError(
                f"{given}: a name consists of small letters, digits and _. "
                f"Try: {program_name()} {shlex.join(command)}"
            )


def refuse_taken_name(kind: str, name: str, files: Sequence[Path]) -> None:
    """Raise UserError if a file is there, or the package has something of this name."""
    package = CONF_FOLDER.parent
    places = [package / path.format(name) for path in PACKAGE_PLACES[kind]]
    for place in (*files, *places):
        if place.exists():
            raise UserError(f"{place}: it is there already. Choose another name.")
    if kind == "stage" and name in stages():
        raise UserError(f"{name}: there is a stage of this name. Choose another name.")


def is_module_name(name: str) -> bool:
    """Tell whether a module can have this name."""
    return bool(NAME_PATTERN.fullmatch(name)) and not keyword.iskeyword(name)


def nearest_module_name(name: str) -> str:
    """Return a name that a module can have, near another one."""
    if is_module_name(name):
        return name
    near = re.sub(r"\W+", "_", name.lower()).strip("_0123456789")
    return near if is_module_name(near) else "mine"


def shown_path(path: Path) -> Path:
    """Return a path from the current folder on, if it lies there."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


Files = dict[str, str]  # texts by their paths within the plugin


def arm_files(name: str, plugin: str) -> tuple[Files, str]:
    """Return settings of an arm, copied from the paper's arm."""
    return copied_settings("arm", name, "paper"), f"+experiment=quick arm={name}"


def camera_files(name: str, plugin: str) -> tuple[Files, str]:
    """Return settings of a camera, copied from the paper's camera."""
    files = copied_settings("camera", name, "highspeed")
    return files, f"+experiment=stringB method=robust camera={name}"


def copied_settings(group: str, name: str, like: str) -> Files:
    """Return an option of a group of settings, as a copy of another option."""
    text = (CONF_FOLDER / group / f"{like}.yaml").read_text(encoding="utf-8")
    settings = [line for line in text.splitlines() if not line.startswith("#")]
    heading = f"# {name}: a copy of {like}. Change what is different."
    return {f"conf/{group}/{name}.yaml": "\n".join([heading, *settings, ""])}


def effect_files(name: str, plugin: str) -> tuple[Files, str]:
    """Return the file of an effect."""
    files = {f"effects/{name}.py": fill_template(EFFECT_TEMPLATE, name, plugin)}
    return files, f"+experiment=quick 'effects=[{name}]' estimate=least_squares"


def estimator_files(name: str, plugin: str) -> tuple[Files, str]:
    """Return an estimator: a function and an option of a group of settings."""
    settings = fill_template(ESTIMATOR_SETTINGS_TEMPLATE, name, plugin)
    files = {
        f"estimate/{name}.py": fill_template(ESTIMATOR_TEMPLATE, name, plugin),
        f"conf/estimate/{name}.yaml": settings,
    }
    return files, f"+experiment=quick estimate={name}"


def stage_files(name: str, plugin: str) -> tuple[Files, str]:
    """Return a stage: a folder and a group of settings."""
    files = {
        f"stages/{name}/__init__.py": fill_template(STAGE_TEMPLATE, name, plugin),
        f"stages/{name}/{name}.py": fill_template(FUNCTION_TEMPLATE, name, plugin),
        f"conf/{name}/plain.yaml": fill_template(SETTINGS_TEMPLATE, name, plugin),
    }
    return files, f"+{name}=plain mode=batch mode.stage={name} trials=data/sample"


FILES_OF_KIND: dict[str, Callable[[str, str], tuple[Files, str]]] = {
    "arm": arm_files,
    "camera": camera_files,
    "effect": effect_files,
    "estimator": estimator_files,
    "stage": stage_files,
}


def fill_template(text: str, name: str, plugin: str) -> str:
    """Fill names into a template; that of the file also as the name of a class."""
    class_name = "".join(part.capitalize() for part in name.split("_"))
    return text.format(name=name, Name=class_name, plugin=plugin)
