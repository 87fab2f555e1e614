"""Mistakes that people make on the command line, each answered by the command that was
meant, before Hydra sees it.
"""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

from stringcast.pipeline.commands import COMMAND_NAMES
from stringcast.pipeline.settings.typed_settings import CONF_FOLDER, UserError

# as which it is called is put in where it is printed
CALL_WORDS = ["python", "-m", "pipeline"]
FLAGS = ("-m", "--multirun", "-v", "-h", "--help")
HYDRA_FLAGS = (
    *(
        "--hydra-help",
        "--version",
        "--cfg",
        "-c",
        "--resolve",
        "--package",
        "-p",
        "--run",
        "-r",
        "--info",
        "-i",
    ),
    *(
        "--shell-completion",
        "-sc",
        "--config-path",
        "-cp",
        "--config-name",
        "-cn",
        "--config-dir",
        "-cd",
    ),
    "--experimental-rerun",
)
TASK_NAMES = ("test", "bench", "setup")
EXAMPLE_RUN = ["+experiment=stringB", "method=robust"]  # what tasks.py runs
# experiments that look at stored trials
TRIAL_EXPERIMENTS = ("estimate", "diagnose", "decide")
LENGTH_SETTING = re.compile(
    r"(string\.length|(?:target|arm\.base|obstacles)\.[\w.]+)=(-?[\d.]+)(mm|cm|m|)$"
)
METRES_PER_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
# [m] that no string, target or arm reaches: from there on a number is in millimetres
MAX_LENGTH_M = 20.0


class Answer(NamedTuple):
    """The fault of a word, empty if there is none, and the words that were meant."""

    fault: str
    suggested_words: list[str]


@dataclass(frozen=True)
class Word:
    """A word of the command line. name, value: the text before and behind the equals
    sign; all of it is name where there is none. before: the word before it, empty for
    the first. following: those behind it.
    """

    text: str
    name: str
    value: str
    previous_word: str
    following_words: Sequence[str]

    @property
    def setting(self) -> str:
        """The setting's name, without the + that adds it."""
        return self.name.lstrip("+")

    @property
    def next_word(self) -> str:
        """The word behind it, empty for the last."""
        return self.following_words[0] if self.following_words else ""


def refuse_mistakes(words: Sequence[str]) -> None:
    """Raise UserError for the first word that is not what it is meant for, with the
    command to paste instead.
    """
    if any(word.startswith(("--config-", "hydra.searchpath")) for word in words):
        return  # settings that lie elsewhere are not known here
    answers = [*answer_words(words)]
    faults = [answer.fault for answer in answers if answer.fault]
    better = [
        *dict.fromkeys(word for answer in answers for word in answer.suggested_words)
    ]
    experiment = next(
        (
            word.removeprefix("+experiment=")
            for word in better
            if word.startswith("+experiment=")
        ),
        "",
    )
    if experiment in TRIAL_EXPERIMENTS and not any(
        word.startswith("trials=") for word in better
    ):
        faults.append(
            f"+experiment={experiment} looks at stored trials, and none are named."
        )
        better.append("trials=data/sample")
    if faults:
        raise UserError(
            f"{faults[0]} Try: {shlex.join(CALL_WORDS + better)}"
            if better != [*words]
            else faults[0]
        )


def answer_words(words: Sequence[str]) -> Iterator[Answer]:
    """The answer to each word that stands for itself. The words behind a command are
    the command's own.
    """
    command = False
    for place, text in enumerate(words):
        name, _, value = text.partition("=")
        word = Word(
            text, name, value, words[place - 1] if place else "", words[place + 1 :]
        )
        right = Answer("", [text])
        # answered with the word before it: `--experiment stringB`, `seed = 3`, `seed:
        # 3`
        alone = "=" not in word.previous_word and (
            word.previous_word.endswith(":")
            or bool(setting_given_as_option(word.previous_word))
        )
        second = text == "=" or word.previous_word == "=" or alone
        if command:
            yield right
        elif not second:
            # of several mistakes that a word may be, the first that fits
            faults = (
                check_option
                if text.startswith(("-", "~"))
                else check_setting
                if "=" in text
                else check_bare_word
            )
            answer = next(faults(word), right)
            command = place == 0 and answer.suggested_words[0] in COMMAND_NAMES
            yield answer


# --- kinds of words, each with the mistakes that are made with it, most likely first
# --------------
def check_option(word: Word) -> Iterator[Answer]:
    """Of a word that begins with a dash, or with a tilde, which takes a setting out."""
    if name := setting_given_as_option(word.text):
        what = "an experiment" if name == "experiment" else "a setting"
        yield Answer(
            f"{word.text}: {what} has no dashes before it.",
            [write_setting(name, word.value or word.next_word)],
        )
    if word.text.startswith("-") and word.name not in (*FLAGS, *HYDRA_FLAGS):
        fault = "there is no such option. A setting has no dashes: name=value. All: python -m pipeline --help"
        yield Answer(f"{word.text}: {fault}", [word.text])


def check_setting(word: Word) -> Iterator[Answer]:
    """Of name=value."""
    if word.name == "experiment":
        yield Answer(
            f"{word.text}: an experiment is added to the settings.",
            [write_setting(word.name, word.value)],
        )
    place = re.fullmatch(r"[\[(]?(-?[\d.]+),(-?[\d.]+)[\])]?", word.value)
    if word.setting == "target" and place:
        x, y = (to_metres(float(part)) for part in place.groups())
        yield Answer(
            f"{word.text}: a place has a setting for each coordinate.",
            [f"target.x={x:g}", f"target.y={y:g}"],
        )
    yield from check_choice(word)
    yield from check_choice_as_setting(word)
    length = LENGTH_SETTING.match(word.text)
    if length and (length[3] or abs(float(length[2])) >= MAX_LENGTH_M):
        number = (
            float(length[2]) * METRES_PER_UNIT[length[3]]
            if length[3]
            else to_metres(float(length[2]))
        )
        yield Answer(
            f"{word.text}: lengths are in metres, without a unit.",
            [f"{word.name}={number:g}"],
        )
    if (
        word.name in ("effects", "own")
        and re.fullmatch(r"[a-z_,\d]+", word.value)
        and word.value != "null"
    ):
        yield Answer(f"{word.text}: it is a list.", [f"{word.name}=[{word.value}]"])
    if word.name.partition(".")[0] == "known":
        yield Answer(
            f"{word.text}: what is known is added to the settings.", [f"+{word.text}"]
        )
    yield from check_setting_name(word)


def check_bare_word(word: Word) -> Iterator[Answer]:
    """Of a word without an equals sign: a command, or what is none."""
    name, colon = word.text.rstrip(":"), word.text.endswith(":")
    if is_setting(name) and word.following_words and (colon or word.next_word == "="):
        value = word.next_word if colon else "".join(word.following_words[1:2])
        yield Answer(
            f"{name}: name and value belong together.", [write_setting(name, value)]
        )
    if Path(word.text).is_dir():
        yield Answer(
            f"{word.text}: a folder of trials is a setting.", [f"trials={word.text}"]
        )
    if not word.previous_word and word.text == "run":
        yield Answer("run: this program runs what its settings say.", EXAMPLE_RUN)
    if not word.previous_word and word.text in TASK_NAMES:
        yield Answer(
            f"{word.text}: this is what tasks.py does: python3 tasks.py {word.text}",
            [word.text],
        )
    if word.text in ("help", "?"):
        yield Answer(f"{word.text}: help is an option.", ["--help"])
    near = nearest_name(word.text, [*COMMAND_NAMES, *group_options("experiment")])
    if not word.previous_word and near in COMMAND_NAMES:
        yield Answer(f"{word.text}: there is no such command.", [near])
    if near := nearest_name(word.text, group_options("experiment")):
        yield Answer(
            f"{word.text}: an experiment is added to the settings.",
            [f"+experiment={near}"],
        )
    fault = f"this is neither a command ({', '.join(COMMAND_NAMES)}) nor a setting (name=value). See --help."
    yield Answer(f"{word.text}: {fault}", [word.text])


def check_choice(word: Word) -> Iterator[Answer]:
    """An unknown option of a group, such as estimate=least_square; several at once, as
    in a sweep, are Hydra's to read.
    """
    there = group_options(word.setting)
    if (
        not there
        or word.value in ("", "null", *there)
        or re.search(r"[,()\[{$]", word.value)
    ):
        return
    # in a folder of the group
    if (CONF_FOLDER / word.setting / word.value).with_suffix(".yaml").exists():
        return
    near = nearest_name(word.value, there)
    known = (
        ""
        if near
        else f"; there {'are' if len(there) > 1 else 'is'} {', '.join(there)}"
    )
    if not near and word.setting in ("arm", "camera"):
        known += f"; python -m pipeline new {word.setting} {word.value} writes one of your own"
    yield Answer(
        f"{word.text}: there is no such option{known}.",
        [f"{word.name}={near or word.value}"],
    )


def check_choice_as_setting(word: Word) -> Iterator[Answer]:
    """An option as if it were a setting, source.video=film.mp4: meant is what the
    option leaves to be given.
    """
    group, _, option = word.setting.partition(".")
    if option in group_options(group):
        file = (CONF_FOLDER / group / option).with_suffix(".yaml")
        if left := re.search(r"^(\w+): null\b", file.read_text(encoding="utf-8"), re.M):
            meant = [f"{group}={option}", f"{group}.{left[1]}={word.value}"]
            yield Answer(f"{word.text}: {option} is an option of {group}.", meant)


def check_setting_name(word: Word) -> Iterator[Answer]:
    """The nearest known one, by its first name."""
    if not is_setting(word.setting):
        top, dot, inner = word.setting.partition(".")
        near = nearest_name(top, [*top_level_settings(), *group_names()])
        meant = write_setting(f"{near}{dot}{inner}", word.value) if near else word.text
        listed = "" if near else " All of them: python -m pipeline --help"
        yield Answer(f"{word.text}: there is no setting '{top}'.{listed}", [meant])


# --- what there is
# -----------------------------------------------------------------------------
def setting_given_as_option(word: str) -> str:
    """The setting that is given as an option of other programs: `--seed`,
    `--experiment=stringB`.
    """
    name = word.removeprefix("--").partition("=")[0]
    return (
        name if word.startswith("--") and word not in FLAGS and is_setting(name) else ""
    )


def write_setting(name: str, value: str) -> str:
    """A setting as it is given; an experiment is added."""
    return f"{'+' * (name == 'experiment')}{name}={value}"


def to_metres(number: float) -> float:
    """A length that may be in millimetres [m]."""
    return number / 1e3 if abs(number) >= MAX_LENGTH_M else number


def is_setting(name: str) -> bool:
    """Whether there is a setting or a group whose first name is this one's."""
    return re.split(r"[./@]", name)[0] in {
        *top_level_settings(),
        *group_names(),
        "hydra",
    }


@cache
def group_options(group: str) -> tuple[str, ...]:
    """Options of a group."""
    return tuple(sorted(file.stem for file in (CONF_FOLDER / group).glob("*.yaml")))


@cache
def group_names() -> tuple[str, ...]:
    """Groups of settings."""
    return tuple(
        sorted(
            folder.name
            for folder in CONF_FOLDER.iterdir()
            if folder.is_dir() and folder.name[0] != "_"
        )
    )


@cache
def top_level_settings() -> tuple[str, ...]:
    """Settings of no group, and blocks that a group or an experiment brings, by their
    first names.
    """
    files = (CONF_FOLDER / "config.yaml", *(CONF_FOLDER / "experiment").glob("*.yaml"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    return tuple(
        dict.fromkeys(
            re.findall(r"^(\w+):", text, re.M) + re.findall(r"- \w+@(\w+):", text)
        )
    )


def nearest_name(word: str, known: Sequence[str]) -> str:
    """The name that is most like a word, whatever its capitals; empty if none is."""
    lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), lower, 1)
    return lower[near[0]] if near else ""
