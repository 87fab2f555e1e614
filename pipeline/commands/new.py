"""Write a working start of an arm, camera, effect, estimator or stage of your own."""

from __future__ import annotations

import keyword
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2

from stringcast.data.store import write_text
from stringcast.pipeline.cli.terminal import Terminal, program_name
from stringcast.pipeline.commands import CommandParser
from stringcast.pipeline.settings.composition import CONF_FOLDER, UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import NAME_PATTERN

DEFAULT_PLUGIN = Path("my_lab")
TEMPLATES = Path(__file__).with_name("new_templates")


class Kind(NamedTuple):
    """A kind of files that `new` writes.

    files: templates of Jinja by path within the plugin. example: arguments of a run
    with them. places: where the package may use the name.
    """

    files: Mapping[str, str]
    example: str
    places: Sequence[str]


def copied_settings(group: str, like: str) -> str:
    """Return the template of an option of a group, as a copy of another option."""
    text = (CONF_FOLDER / group / f"{like}.yaml").read_text(encoding="utf-8")
    settings = [line for line in text.splitlines() if not line.startswith("#")]
    heading = f"# {{{{ name }}}}: a copy of {like}. Change what is different."
    return "\n".join([heading, *settings, ""])


def read_template(name: str) -> str:
    """Return the template of a file."""
    return (TEMPLATES / f"{name}.j2").read_text(encoding="utf-8")


KINDS = {
    "arm": Kind(
        {"conf/arm/{name}.yaml": copied_settings("arm", "paper")},
        "+experiment=quick arm={name}",
        ["conf/arm/{name}.yaml"],
    ),
    "camera": Kind(
        {"conf/camera/{name}.yaml": copied_settings("camera", "highspeed")},
        "+experiment=stringB method=robust camera={name}",
        ["conf/camera/{name}.yaml"],
    ),
    "effect": Kind(
        {"effects/{name}.py": read_template("effect.py")},
        "+experiment=quick 'effects=[{name}]' estimate=least_squares",
        ["stages/model/effects/{name}.py"],
    ),
    "estimator": Kind(
        {
            "estimate/{name}.py": read_template("estimator.py"),
            "conf/estimate/{name}.yaml": read_template("estimator.yaml"),
        },
        "+experiment=quick estimate={name}",
        ["conf/estimate/{name}.yaml"],
    ),
    "stage": Kind(
        {
            "stages/{name}/__init__.py": read_template("stage.py"),
            "stages/{name}/{name}.py": read_template("stage_function.py"),
            "conf/{name}/plain.yaml": read_template("stage.yaml"),
        },
        "+{name}=plain mode=batch mode.stage={name} trials=data/sample",
        ["stages/{name}", "conf/{name}"],
    ),
}


def main(arguments: Sequence[str]) -> int:
    """Write the files and return the exit status 0."""
    parser = CommandParser("python -m pipeline new", description=__doc__)
    parser.add_argument("kind", choices=list(KINDS), help="what to write")
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
    refuse_odd_names(name, plugin)
    texts = fill_templates(kind, name, plugin.name)
    files = [plugin / path for path in texts]
    refuse_taken_name(kind, name, files)
    for file, text in zip(files, texts.values(), strict=True):
        write_text(file, text)
    console = Terminal()
    for file in files:
        console.print_line(f"Written: {shown_path(file)}")
    example = KINDS[kind].example.format(name=name)
    setting = shlex.quote(f"plugins=[{shown_path(plugin)}]")
    console.print_line(f"Try it: {program_name()} {setting} {example}")
    return 0


def fill_templates(kind: str, name: str, plugin: str) -> dict[str, str]:
    """Return the texts of the files of a kind, by path within the plugin."""
    class_name = "".join(part.capitalize() for part in name.split("_"))
    words = {"name": name, "Name": class_name, "plugin": plugin}
    templates = jinja2.Environment(
        undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    texts = {}
    for path, template in KINDS[kind].files.items():
        texts[path.format(name=name)] = templates.from_string(template).render(words)
    return texts


def refuse_odd_names(name: str, plugin: Path) -> None:
    """Raise UserError unless name and folder name are valid module names."""
    for given in (name, plugin.name):
        if not NAME_PATTERN.fullmatch(given) or keyword.iskeyword(given):
            raise UserError(
                given,
                "a name consists of small letters, digits and _, and begins "
                "with a letter",
                "Try another, such as my_arm.",
            )


def refuse_taken_name(kind: str, name: str, files: Sequence[Path]) -> None:
    """Raise UserError if a file exists, or the package uses the name."""
    package = CONF_FOLDER.parent
    places = [package / path.format(name=name) for path in KINDS[kind].places]
    for place in (*files, *places):
        if place.exists():
            raise UserError(place, "it is there already", "Choose another name.")
    if kind == "stage" and name in stages():
        raise UserError(
            name,
            "there is a stage of this name",
            "Choose another name.",
        )


def shown_path(path: Path) -> Path:
    """Return a path relative to the current folder, if it lies in it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
