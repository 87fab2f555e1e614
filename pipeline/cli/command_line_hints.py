"""Answer frequent mistakes on the command line with the intended command."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import NamedTuple

from stringcast.pipeline.commands import COMMAND_NAMES
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    UserError,
    conf_folders,
    group_files,
)

# replaced by the actual program call in messages
CALL_WORDS = ["python", "-m", "pipeline"]
FLAGS = ("-m", "--multirun", "-v", "-h", "--help")
# options of Hydra with a value, and without
HYDRA_VALUE_FLAGS = (
    *("--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun"),
    *("--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"),
)
HYDRA_FLAGS = (
    *HYDRA_VALUE_FLAGS,
    *("--hydra-help", "--version", "--resolve", "--run", "-r"),
    *("--shell-completion", "-sc"),
)
# options that take settings from another folder, which are not known here
OTHER_FOLDER_FLAGS = ("--config-", "-cp", "-cn", "-cd", "hydra.searchpath")
TASK_NAMES = ("test", "bench", "setup", "study", "docs", "package")
EXAMPLE_RUN = ["+experiment=stringB", "method=adaptive"]  # as `tasks.py run`
TRIAL_EXPERIMENTS = ("estimate", "diagnose", "decide")  # these need stored trials
LENGTH_SETTING = re.compile(
    r"(string\.length|(?:target|arm\.base|obstacles)\.[\w.]+)=(-?[\d.]+)(mm|cm|m|)$"
)
METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
# [m]: larger than any string, target or arm, so in millimetres
MAX_LENGTH_M = 20.0


class Answer(NamedTuple):
    """The fault of a word, empty without one, and its replacement."""

    fault: str
    suggested_words: list[str]


@dataclass(frozen=True)
class Word:
    """A word of the command line with its neighbours.

    Parameters
    ----------
    text : str
        The word.
    name, value : str
        The text before and after the equals sign; without one, all of it is `name`.
    previous_word : str
        The word before it, empty for the first.
    following_words : sequence of str
        The words after it.
    """

    text: str
    name: str
    value: str
    previous_word: str
    following_words: Sequence[str]

    @property
    def setting(self) -> str:
        """Name of the setting without a leading plus sign."""
        return self.name.lstrip("+")

    @property
    def next_word(self) -> str:
        """Word after this one, empty for the last."""
        return self.following_words[0] if self.following_words else ""


def join_quoted(words: Sequence[str]) -> list[str]:
    """Join words between single quotes, and remove the quotes.

    cmd.exe of Windows does not treat single quotes as quotes and splits at blanks.
    """
    joined: list[str] = []
    open_words: list[str] = []
    for word in words:
        if not open_words and not word.startswith("'"):
            joined.append(word)
            continue
        open_words.append(word)
        text = " ".join(open_words)
        if len(text) > 1 and text.endswith("'"):
            joined.append(text[1:-1])
            open_words = []
    return joined + open_words


def refuse_mistakes(words: Sequence[str]) -> None:
    """Raise UserError for the first mistaken word, with the corrected command."""
    if any(word.startswith(OTHER_FOLDER_FLAGS) for word in words):
        return
    if {"--shell-completion", "-sc", "--experimental-rerun"} & set(words):
        return  # these only print

    answers = list(answer_words(words))
    faults = [answer.fault for answer in answers if answer.fault]
    suggested_words = (answer.suggested_words for answer in answers)
    suggested = list(dict.fromkeys(chain.from_iterable(suggested_words)))

    trials_given = any(word.startswith("trials=") for word in suggested)
    for experiment in TRIAL_EXPERIMENTS:
        if f"+experiment={experiment}" in suggested and not trials_given:
            faults.append(
                f"+experiment={experiment} needs stored trials, and none are given."
            )
            suggested.append("trials=data/sample")

    if not faults:
        return
    if suggested == list(words):
        raise UserError("", faults[0])
    raise UserError("", faults[0], f"Try: {shlex.join(CALL_WORDS + suggested)}")


def answer_words(words: Sequence[str]) -> Iterator[Answer]:
    """Yield the answer to each word that no earlier answer covers."""
    in_command = False
    for position, text in enumerate(words):
        name, _, value = text.partition("=")
        previous_word = words[position - 1] if position else ""
        word = Word(text, name, value, previous_word, words[position + 1 :])
        correct = Answer("", [text])
        of_hydra = previous_word in HYDRA_VALUE_FLAGS and not set(text) & set("=-")
        # a command parses the words after it
        if in_command or of_hydra:
            yield correct
        elif not is_second_part(word):
            answer = next(possible_answers(word), correct)
            in_command = position == 0 and answer.suggested_words[0] in COMMAND_NAMES
            yield answer


def is_second_part(word: Word) -> bool:
    """Return whether a word is the value of the previous one.

    Examples: `--experiment stringB`, `seed = 3`, `seed: 3`.
    """
    if "=" in (word.text, word.previous_word):
        return True
    if "=" in word.previous_word:
        return False
    is_option = bool(setting_given_as_option(word.previous_word))
    return is_option or word.previous_word.endswith(":")


def possible_answers(word: Word) -> Iterator[Answer]:
    """Yield possible answers to a word, the most likely first."""
    if word.text.startswith(("-", "~")):
        return check_option(word)
    return check_setting(word) if "=" in word.text else check_bare_word(word)


def check_option(word: Word) -> Iterator[Answer]:
    """Answer a word that begins with a dash or a tilde."""
    if name := setting_given_as_option(word.text):
        kind = "an experiment" if name == "experiment" else "a setting"
        fault = f"{word.text}: {kind} has no dashes before it."
        yield Answer(fault, [write_setting(name, word.value or word.next_word)])
    if word.text.startswith("-") and word.name not in (*FLAGS, *HYDRA_FLAGS):
        fault = (
            f"{word.text}: there is no such option. A setting is name=value. "
            "All settings: python -m pipeline --help"
        )
        yield Answer(fault, [word.text])


def check_setting(word: Word) -> Iterator[Answer]:
    """Answer a word of the form name=value."""
    if word.name == "experiment":
        fault = f"{word.text}: an experiment has a plus sign before it."
        yield Answer(fault, [write_setting(word.name, word.value)])
    place = re.fullmatch(r"[\[(]?(-?[\d.]+),(-?[\d.]+)[\])]?", word.value)
    if word.setting == "target" and place:
        x, y = to_metres(float(place[1])), to_metres(float(place[2]))
        fault = f"{word.text}: give each coordinate."
        yield Answer(fault, [f"target.x={x:g}", f"target.y={y:g}"])
    # not `Path.exists`, which fails for words longer than a file name
    if re.search(r"[,()\[\]{}]", word.value) and os.path.exists(word.value):
        fault = f"{word.text}: a path with commas or brackets needs quotes of its own."
        yield Answer(fault, [f'{word.name}="{word.value}"'])
    yield from check_choice(word)
    yield from check_choice_as_setting(word)
    length = LENGTH_SETTING.match(word.text)
    if length and (length[3] or abs(float(length[2])) >= MAX_LENGTH_M):
        metres = to_metres(float(length[2]), length[3])
        fault = f"{word.text}: lengths are in metres, without a unit."
        yield Answer(fault, [f"{word.name}={metres:g}"])
    is_list = re.fullmatch(r"[a-z_,\d]+", word.value) and word.value != "null"
    if word.name in ("effects", "effects_per_recording") and is_list:
        yield Answer(f"{word.text}: this is a list.", [f"{word.name}=[{word.value}]"])
    if word.name.partition(".")[0] == "parameter_values":
        fault = f"{word.text}: a value of a parameter has a plus sign before it."
        yield Answer(fault, [f"+{word.text}"])
    yield from check_setting_name(word)


def check_bare_word(word: Word) -> Iterator[Answer]:
    """Answer a word without an equals sign: a command, or something else."""
    name = word.text.rstrip(":")
    value = None
    if word.text.endswith(":") and word.following_words:
        value = word.next_word
    elif word.next_word == "=":
        value = "".join(word.following_words[1:2])
    if is_setting(name) and value is not None:
        fault = f"{name}: write name and value together."
        yield Answer(fault, [write_setting(name, value)])
    if os.path.isdir(word.text):
        fault = f"{word.text}: give a folder of trials as a setting."
        yield Answer(fault, [f"trials={word.text}"])

    is_first = not word.previous_word
    if is_first and word.text == "run":
        yield Answer("run: the settings alone say what is run.", EXAMPLE_RUN)
    if is_first and word.text in TASK_NAMES:
        yield Answer(f"{word.text}: use python3 tasks.py {word.text}", [word.text])
    if word.text in ("help", "?"):
        yield Answer(f"{word.text}: help is an option.", ["--help"])

    experiments = group_options("experiment")
    command = nearest_name(word.text, [*COMMAND_NAMES, *experiments])
    if is_first and command in COMMAND_NAMES:
        yield Answer(f"{word.text}: there is no such command.", [command])
    if experiment := nearest_name(word.text, experiments):
        fault = f"{word.text}: an experiment has a plus sign before it."
        yield Answer(fault, [f"+experiment={experiment}"])
    fault = (
        f"{word.text}: this is neither a command ({', '.join(COMMAND_NAMES)}) "
        "nor a setting (name=value). See --help."
    )
    yield Answer(fault, [word.text])


def check_choice(word: Word) -> Iterator[Answer]:
    """Answer an unknown option of a group, such as estimate=least_square.

    Several options at once, as in a sweep, are left to Hydra.
    """
    options = group_options(word.setting)
    is_several = re.search(r"[,()\[{$]", word.value)
    if not options or word.value in options or is_several:
        return
    # an option may be in a subfolder of the group
    if (CONF_FOLDER / word.setting / word.value).with_suffix(".yaml").exists():
        return
    fault = f"{word.text}: there is no such option"
    if near := nearest_name(word.value, options):
        yield Answer(f"{fault}.", [f"{word.name}={near}"])
        return
    verb = "are" if len(options) > 1 else "is"
    fault += f"; there {verb} {', '.join(options)}"
    if word.setting in ("arm", "camera"):
        fault += f"; python -m pipeline new {word.setting} {word.value} writes your own"
    if word.setting == "hardware":
        fault += (
            f"; python -m pipeline new arm {word.value} writes the settings of an arm "
            "of your own, and hardware/README.md explains how to write its driver"
        )
    yield Answer(f"{fault}.", [f"{word.name}={word.value}"])


def check_choice_as_setting(word: Word) -> Iterator[Answer]:
    """Answer an option given as a setting, such as source.video=film.mp4."""
    group, _, option = word.setting.partition(".")
    if option not in group_options(group):
        return
    (file,) = [file for file in group_files(group) if file.stem == option]
    text = file.read_text(encoding="utf-8")
    if needed := re.search(r"^(\w+): null\b", text, re.M):
        suggested_words = [f"{group}={option}", f"{group}.{needed[1]}={word.value}"]
        yield Answer(f"{word.text}: {option} is an option of {group}.", suggested_words)


def check_setting_name(word: Word) -> Iterator[Answer]:
    """Answer an unknown setting with the most similar known one."""
    if is_setting(word.setting):
        return
    first_name, dot, rest = word.setting.partition(".")
    fault = f"{word.text}: there is no setting '{first_name}'."
    if near := nearest_name(first_name, [*top_level_settings(), *group_names()]):
        yield Answer(fault, [write_setting(f"{near}{dot}{rest}", word.value)])
    else:
        yield Answer(f"{fault} All settings: python -m pipeline --help", [word.text])


def setting_given_as_option(word: str) -> str:
    """Return the setting given like an option, as in `--seed`, or nothing."""
    name = word.removeprefix("--").partition("=")[0]
    is_option = word.startswith("--") and word not in FLAGS
    return name if is_option and is_setting(name) else ""


def write_setting(name: str, value: str) -> str:
    """Write a setting as on the command line."""
    plus = "+" if name == "experiment" else ""
    return f"{plus}{name}={value}"


def to_metres(number: float, unit: str = "") -> float:
    """Convert a length to metres; without a unit, a large one is in millimetres."""
    if unit:
        return number * METRES_PER_UNIT[unit]
    return number / 1e3 if abs(number) >= MAX_LENGTH_M else number


def is_setting(name: str) -> bool:
    """Return whether a setting or a group has this first name."""
    first_name = re.split(r"[./@]", name)[0]
    return first_name in {*top_level_settings(), *group_names(), "hydra"}


def group_options(group: str) -> tuple[str, ...]:
    """Return the options of a group."""
    return tuple(sorted(file.stem for file in group_files(group)))


def group_names() -> tuple[str, ...]:
    """Return the names of all groups of settings."""
    names = set()
    for folder in conf_folders():
        names |= {path.name for path in folder.iterdir() if path.is_dir()}
    return tuple(sorted(name for name in names if not name.startswith("_")))


@cache
def top_level_settings() -> tuple[str, ...]:
    """Return the first names of settings outside groups, including experiments."""
    files = (CONF_FOLDER / "config.yaml", *(CONF_FOLDER / "experiment").glob("*.yaml"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    names = re.findall(r"^(\w+):", text, re.M) + re.findall(r"- \w+@(\w+):", text)
    return tuple(dict.fromkeys(names))


def nearest_name(word: str, names: Sequence[str]) -> str:
    """Return the most similar name, ignoring case; empty without one."""
    by_lower_case = {name.lower(): name for name in names}
    near = difflib.get_close_matches(word.lower(), by_lower_case, 1)
    return by_lower_case[near[0]] if near else ""
