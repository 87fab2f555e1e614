"""Write a small start of an arm, a camera, an effect or a stage of your own, that works
as it is.
"""

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
"""Say in a line what is so: here the whole string is pulled to the right."""

from stringcast.stages.model.effect import Parameter, Quantity, StringEffect, Values, vanishes_at_zero


class {Name}(StringEffect):
    """Say what the law is, where it holds and what it leaves out."""

    name = "{name}"
    parameters = (  # name, unit, meaning, least, most, and where it begins: there the effect is absent
        Parameter("strength", "m/s2", "steady pull to the right, over mass", -2.0, 2.0, 0.0),
    )
    reference = "Where the law is from"
    invariants = (vanishes_at_zero("acceleration", "strength"),)  # tests hold it to these; others: invariants.py

    @staticmethod
    def describe(values: Values) -> str:
        return f"the string is pulled to the right with {{values['strength']:.3f}} m/s2"

    @staticmethod
    def acceleration(strength: Quantity) -> tuple[Quantity, Quantity]:  # one of the slots in engine/law_slots.py
        return strength, 0.0 * strength
'''
STAGE_TEMPLATE = '''\
"""{Name}: say in a line what it finds out; here how far the tip of each trial goes from where it begins."""

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from stringcast.data.artifacts import TrialSet
from stringcast.data.schema import Column, Table
from stringcast.stages.spec import StageSpec, Summary, This

FARTHEST = Table(
    "farthest", "a row a trial", (Column("trial", "", "its name", "text"), Column("sway", "m", "of its tip, at most"))
)


@dataclass(frozen=True)
class {Name}:
    """What it makes: a field for each table."""

    farthest: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {{"farthest": FARTHEST}}


def summary(made: {Name}) -> Summary:
    """Title, sentence and table for the terminal."""
    return Summary("{name}", f"The tip goes {{made.farthest['sway'].max():.3f}} m at most.", made.farthest.round(3))


STAGE = StageSpec(
    name="{name}",  # of its group of settings
    makes={Name},
    folder="{name}",  # where it lies in an iteration
    uses=("{name}",),  # settings that decide what comes out: another value makes it stale
    run="stages.{name}.{name}.run",  # from the artifacts below to its own
    inputs={{"trials": This(TrialSet)}},  # Last(Estimate): of an earlier iteration, if any
    by=("stages.{name}.{name}.{name}",),  # what `_target_` of conf/{name}/*.yaml may name
    summary=summary,
)
'''
FUNCTION_TEMPLATE = '''\
"""How far a tip goes."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from stringcast.data.artifacts import Observation, TrialSet
from stringcast.stages.common import Progress
from stringcast.stages.spec import Call
from stringcast.stages.{name} import FARTHEST, {Name}


def run(call: Call, trials: TrialSet) -> {Name}:
    """The stage, on all trials that it is given."""
    made: {Name} = call.by(trials.observations, progress=call.progress)
    return made


def {name}(
    observations: Sequence[Observation],
    *,
    least: Annotated[float, Field(ge=0)],
    progress: Progress = lambda share: None,
) -> {Name}:
    """A pure function: artifacts by position, settings by name. least: that is told of [m]."""
    rows = []
    for trial in observations:
        tip = trial.read[trial.read["s"] == trial.read["s"].max()]
        far = np.hypot(tip["x"] - tip["x"].iloc[0], tip["y"] - tip["y"].iloc[0]).max()
        rows += [{{"trial": trial.trial, "sway": far}}] if far > least else []
    return {Name}(FARTHEST.check(pd.DataFrame(rows)))
'''
SETTINGS_TEMPLATE = """\
# What is to be set of it; each is a keyword of the function.
_target_: stages.{name}.{name}.{name}
least: 0.0   # that is told of [m]
"""


def main(arguments: Sequence[str]) -> int:
    """Write the files; 0."""
    parser = CommandParser("python -m pipeline new", description=__doc__)
    parser.add_argument("kind", choices=list(FILES_OF_KIND), help="of what")
    parser.add_argument("name", help="its name: small letters, digits and _")
    asked = parser.parse_args(arguments)
    if not NAME_PATTERN.fullmatch(asked.name) or keyword.iskeyword(asked.name):
        near = re.sub(r"\W+", "_", asked.name.lower()).strip("_0123456789") or "mine"
        raise UserError(
            f"{asked.name}: a name is of small letters, digits and _. Try: {program_name()} new {asked.kind} {near}"
        )
    files, use = FILES_OF_KIND[asked.kind](asked.name)
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
        console.print(
            f"Written: {shown}", highlight=False, markup=False, soft_wrap=True
        )
    console.print(
        f"Try it: {program_name()} {use}", highlight=False, markup=False, soft_wrap=True
    )
    return 0


Files = dict[Path, str]


def arm_files(name: str) -> tuple[Files, str]:
    """The settings of an arm: those of the paper's, to be changed."""
    return copied_settings("arm", name, "paper"), f"+experiment=quick arm={name}"


def camera_files(name: str) -> tuple[Files, str]:
    """Settings of a camera: those of the paper's bench, to be changed or measured."""
    return copied_settings(
        "camera", name, "highspeed"
    ), f"+experiment=stringB method=robust camera={name}"


def copied_settings(group: str, name: str, like: str) -> Files:
    """An option of a group of settings, made of another whose comments say what each
    is.
    """
    text = (CONF_FOLDER / group / f"{like}.yaml").read_text(encoding="utf-8")
    own = [line for line in text.splitlines() if not line.startswith("#")]
    return {
        CONF_FOLDER / group / f"{name}.yaml": "\n".join(
            [f"# {name}: a copy of {like}. Change what is different.", *own, ""]
        )
    }


def effect_files(name: str) -> tuple[Files, str]:
    """An effect, among those of the library or in the first of the folders that
    STRINGCAST_EFFECTS names.
    """
    elsewhere = [
        folder
        for folder in os.environ.get("STRINGCAST_EFFECTS", "").split(os.pathsep)
        if folder
    ]
    folder = (
        Path(elsewhere[0])
        if elsewhere
        else PROJECT_FOLDER / "stages" / "model" / "effects"
    )
    return {
        folder / f"{name}.py": fill_template(EFFECT_TEMPLATE, name)
    }, f"+experiment=quick 'effects=[{name}]' estimate=least_squares"


def stage_files(name: str) -> tuple[Files, str]:
    """A stage: a folder and a group of settings."""
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
    """A template with a name put in, as it is and as a class is called."""
    return text.format(
        name=name, Name="".join(part.capitalize() for part in name.split("_"))
    )
