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
from stringcast.pipeline.commands.new_templates import (
    EFFECT_TEMPLATE,
    ESTIMATOR_SETTINGS_TEMPLATE,
    ESTIMATOR_TEMPLATE,
    FUNCTION_TEMPLATE,
    SETTINGS_TEMPLATE,
    STAGE_TEMPLATE,
)
from stringcast.pipeline.settings.composition import CONF_FOLDER, UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.stages.plugins import NAME_PATTERN

DEFAULT_PLUGIN = Path("my_lab")
# places where the package may use a name
PACKAGE_PLACES = {
    "arm": ("conf/arm/{}.yaml",),
    "camera": ("conf/camera/{}.yaml",),
    "effect": ("stages/model/effects/{}.py",),
    "estimator": ("conf/estimate/{}.yaml",),
    "stage": ("stages/{}", "conf/{}"),
}


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
    """Raise UserError unless name and folder name are valid module names."""
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
    """Raise UserError if a file exists, or the package uses the name."""
    package = CONF_FOLDER.parent
    places = [package / path.format(name) for path in PACKAGE_PLACES[kind]]
    for place in (*files, *places):
        if place.exists():
            raise UserError(f"{place}: it is there already. Choose another name.")
    if kind == "stage" and name in stages():
        raise UserError(f"{name}: there is a stage of this name. Choose another name.")


def is_module_name(name: str) -> bool:
    """Return whether this is a valid module name."""
    return bool(NAME_PATTERN.fullmatch(name)) and not keyword.iskeyword(name)


def nearest_module_name(name: str) -> str:
    """Return a valid module name similar to another name."""
    if is_module_name(name):
        return name
    near = re.sub(r"\W+", "_", name.lower()).strip("_0123456789")
    return near if is_module_name(near) else "mine"


def shown_path(path: Path) -> Path:
    """Return a path relative to the current folder, if it lies in it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


Files = dict[str, str]  # texts by path within the plugin


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
    """Fill names into a template, also as a class name."""
    class_name = "".join(part.capitalize() for part in name.split("_"))
    return text.format(name=name, Name=class_name, plugin=plugin)
