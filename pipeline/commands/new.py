"""Write a working start of your own arm, camera, effect or stage."""

from __future__ import annotations

import keyword
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import CONF_FOLDER, UserError

PROJECT_FOLDER = CONF_FOLDER.parent
NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]*")
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
    run="stages.{name}.{name}.run",  # makes the artifact of its inputs
    inputs={{"trials": CollectedTrials(parts={{"points": Points}})}},
    is_end=True,  # its artifact is a result by itself
    by=("stages.{name}.{name}.{name}",),  # allowed as `_target_` in conf/{name}/*.yaml
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
from stringcast.stages.{name} import FARTHEST, {Name}


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
_target_: stages.{name}.{name}.{name}
least: 0.0   # smallest distance that is listed [m]
"""


def main(arguments: Sequence[str]) -> int:
    """Write the files and return the exit status 0."""
    parser = CommandParser("python -m pipeline new", description=__doc__)
    parser.add_argument("kind", choices=list(FILES_OF_KIND), help="what to write")
    parser.add_argument("name", help="name of small letters, digits and _")
    options = parser.parse_args(arguments)
    if not NAME_PATTERN.fullmatch(options.name) or keyword.iskeyword(options.name):
        near = re.sub(r"\W+", "_", options.name.lower()).strip("_0123456789") or "mine"
        fault = f"{options.name}: a name consists of small letters, digits and _"
        command = f"{program_name()} new {options.kind} {near}"
        raise UserError(f"{fault}. Try: {command}")
    files, example = FILES_OF_KIND[options.kind](options.name)
    for path in files:
        if path.exists():
            raise UserError(f"{path}: it is there already. Choose another name.")
    for path, text in files.items():
        write_text(path, text)
    console = Terminal()
    for path in files:
        shown = (
            path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
        )
        console.print_line(f"Written: {shown}")
    console.print_line(f"Try it: {program_name()} {example}")
    return 0


Files = dict[Path, str]


def arm_files(name: str) -> tuple[Files, str]:
    """Return settings of an arm, copied from the paper's arm."""
    return copied_settings("arm", name, "paper"), f"+experiment=quick arm={name}"


def camera_files(name: str) -> tuple[Files, str]:
    """Return settings of a camera, copied from the paper's camera."""
    files = copied_settings("camera", name, "highspeed")
    return files, f"+experiment=stringB method=robust camera={name}"


def copied_settings(group: str, name: str, like: str) -> Files:
    """Return an option of a group of settings, as a copy of another option."""
    text = (CONF_FOLDER / group / f"{like}.yaml").read_text(encoding="utf-8")
    settings = [line for line in text.splitlines() if not line.startswith("#")]
    heading = f"# {name}: a copy of {like}. Change what is different."
    copy = "\n".join([heading, *settings, ""])
    return {CONF_FOLDER / group / f"{name}.yaml": copy}


def effect_files(name: str) -> tuple[Files, str]:
    """Return an effect, in the first folder of STRINGCAST_EFFECTS or in the library."""
    user_folders = os.environ.get("STRINGCAST_EFFECTS", "").split(os.pathsep)
    library = PROJECT_FOLDER / "stages" / "model" / "effects"
    folder = Path(next(filter(None, user_folders), library))
    files = {folder / f"{name}.py": fill_template(EFFECT_TEMPLATE, name)}
    return files, f"+experiment=quick 'effects=[{name}]' estimate=least_squares"


def stage_files(name: str) -> tuple[Files, str]:
    """Return a stage: a folder and a group of settings."""
    folder = PROJECT_FOLDER / "stages" / name
    files = {
        folder / "__init__.py": fill_template(STAGE_TEMPLATE, name),
        folder / f"{name}.py": fill_template(FUNCTION_TEMPLATE, name),
        CONF_FOLDER / name / "plain.yaml": fill_template(SETTINGS_TEMPLATE, name),
    }
    return files, f"+{name}=plain mode=batch mode.stage={name} trials=data/sample"


FILES_OF_KIND: dict[str, Callable[[str], tuple[Files, str]]] = {
    "arm": arm_files,
    "camera": camera_files,
    "effect": effect_files,
    "stage": stage_files,
}


def fill_template(text: str, name: str) -> str:
    """Fill a name into a template, also as the name of a class."""
    class_name = "".join(part.capitalize() for part in name.split("_"))
    return text.format(name=name, Name=class_name)
