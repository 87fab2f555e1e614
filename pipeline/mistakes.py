"""Mistakes that people make on the command line, each answered by the command that was meant, before Hydra sees it."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from stringcast.pipeline.commands import NAMES
from stringcast.pipeline.older import new_name
from stringcast.pipeline.settings import CONF, UserError

CALL = ["python", "-m", "pipeline"]  # as which it is called is put in where it is printed
FLAGS = ("-m", "--multirun", "-v", "-h", "--help")
OF_HYDRA = (
    *("--hydra-help", "--version", "--cfg", "-c", "--resolve", "--package", "-p", "--run", "-r", "--info", "-i"),
    *("--shell-completion", "-sc", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"),
    "--experimental-rerun",
)
OF_TASKS = ("test", "bench", "setup")
BEST = ["+experiment=stringB", "method=robust"]  # what tasks.py runs
FROM_TRIALS = ("estimate", "diagnose", "decide")  # experiments that look at stored trials
IN_METRES = re.compile(r"(string\.length|(?:target|arm\.base|obstacles)\.[\w.]+)=(-?[\d.]+)(mm|cm|m|)$")
FACTORS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
FARTHEST = 20.0  # [m] that no string, target or arm reaches: from there on a number is in millimetres


def refuse_mistakes(words: Sequence[str]) -> None:
    """Raise UserError for the first word that is not what it is meant for, with the command to paste instead."""
    if any(word.startswith(("--config-", "hydra.searchpath")) for word in words):
        return  # settings that lie elsewhere are not known here
    faults: list[str] = []
    better: list[str] = []
    for place, word in enumerate(words):
        if better and better[0] in NAMES:  # whose own words are its own
            better.append(word)
            continue
        before = words[place - 1] if place else ""
        apart = word == "=" or before == "=" or (before.endswith(":") and "=" not in before)
        if apart or (_named_as_option(before) and "=" not in before):
            continue  # answered with the word before it: `--experiment stringB`, `seed = 3`
        fault, meant = next(_of(word, words[place + 1 :], first=place == 0), ("", [word]))
        faults += [fault] if fault else []
        better += meant
    experiment = next((word.removeprefix("+experiment=") for word in better if word.startswith("+experiment=")), "")
    if experiment in FROM_TRIALS and not any(word.startswith("trials=") for word in better):
        faults.append(f"+experiment={experiment} looks at stored trials, and none are named.")
        better.append("trials=data/sample")
    if faults:
        raise UserError(f"{faults[0]} Try: {shlex.join(CALL + better)}" if better != [*words] else faults[0])


def _named_as_option(word: str) -> str:
    """The setting that is given as an option of other programs: `--seed`, `--experiment=stringB`."""
    name = word.removeprefix("--").partition("=")[0]
    return name if word.startswith("--") and word not in FLAGS and _is_setting(name) else ""


def _of(word: str, following: Sequence[str], first: bool) -> Iterator[tuple[str, list[str]]]:
    """The fault of a word, and the words that were meant."""
    name, given, value = word.partition("=")
    if setting := _named_as_option(word):
        value = value or next(iter(following), "")
        what = "an experiment" if setting == "experiment" else "a setting"
        yield f"{word}: {what} has no dashes before it.", [_setting(setting, value)]
    elif word.startswith("-") and word.partition("=")[0] not in (*FLAGS, *OF_HYDRA):
        yield (
            f"{word}: there is no such option. A setting has no dashes: name=value. All: python -m pipeline --help",
            [word],
        )
    elif word.startswith(("-", "~")):  # ~ takes a setting out
        return
    elif name == "experiment" and given:
        yield f"{word}: an experiment is added to the settings.", [f"+experiment={value}"]
    elif name == "steps" and given:
        names = value.strip("[]").replace(" ", "").split(",")  # such as extract,diagnose
        last = {"study": "blind_study", "extract": "cast"}.get(names[-1], names[-1])
        mode = "cast" if "generate" in names else "decide" if "execute" in names else last
        yield f"{word}: what a run does is its mode now.", [f"mode={mode}"]
    elif not given and _is_setting(word.rstrip(":")) and following and (word.endswith(":") or following[0] == "="):
        value = following[0] if word.endswith(":") else following[1] if len(following) > 1 else ""
        yield f"{word}: name and value belong together.", [_setting(word.rstrip(":"), value)]
    elif not given:
        yield from _bare(word, first)
    else:
        yield from _valued(word, name, value)


def _valued(word: str, name: str, value: str) -> Iterator[tuple[str, list[str]]]:
    """The fault of a setting with a value, and the words that were meant."""
    plain = name.lstrip("+")
    if (now := new_name(plain)) != plain:
        yield f"{word}: this setting is called {now} now.", [f"{now}={value}"]
    elif plain == "target" and (place := re.fullmatch(r"[\[(]?(-?[\d.]+),(-?[\d.]+)[\])]?", value)):
        x, y = (_metres(float(part)) for part in place.groups())
        yield f"{word}: a place has a setting for each coordinate.", [f"target.x={x:g}", f"target.y={y:g}"]
    elif (CONF / plain).is_dir() and value and not re.search(r"[,()\[{$]", value):
        yield from _option(name, value)
    elif (found := IN_METRES.match(word)) and (found[3] or abs(float(found[2])) >= FARTHEST):
        number = float(found[2]) * FACTORS[found[3]] if found[3] else _metres(float(found[2]))
        yield f"{word}: lengths are in metres, without a unit.", [f"{name}={number:g}"]
    elif name in ("effects", "own") and re.fullmatch(r"[a-z_,\d]+", value) and value != "null":
        yield f"{word}: it is a list.", [f"{name}=[{value}]"]
    elif name == "known" or name.startswith("known."):
        yield f"{word}: what is known is added to the settings.", [f"+{word}"]
    elif not _is_setting(plain):
        yield from _unknown(word, plain, value)


def _metres(number: float) -> float:
    """A length that may be in millimetres [m]."""
    return number / 1e3 if abs(number) >= FARTHEST else number


def _unknown(word: str, plain: str, value: str) -> Iterator[tuple[str, list[str]]]:
    """The fault of an unknown setting, and the nearest known one, by its first name."""
    top, dot, inner = plain.partition(".")
    near = _nearest(top, [*_settings(), *_groups()])
    fault = f"{word}: there is no setting '{top}'."
    if near:
        yield fault, [_setting(f"{near}{dot}{inner}", value)]
    else:
        yield f"{fault} All of them: python -m pipeline --help", [word]


def _setting(name: str, value: str) -> str:
    """A setting as it is given; an experiment is added."""
    return f"{'+' * (name == 'experiment')}{name}={value}"


def _is_setting(name: str) -> bool:
    """Whether there is a setting or a group whose first name is this one's."""
    return re.split(r"[./@]", name)[0] in {*_settings(), *_groups(), "hydra"}


def _bare(word: str, first: bool) -> Iterator[tuple[str, list[str]]]:
    """The fault of a word without a value, and the words that were meant."""
    if Path(word).is_dir():
        yield f"{word}: a folder of trials is a setting.", [f"trials={word}"]
    elif first and word == "run":
        yield "run: this program runs what its settings say.", BEST
    elif first and word in OF_TASKS:
        yield f"{word}: this is what tasks.py does: python3 tasks.py {word}", [word]
    elif word in ("help", "?"):
        yield f"{word}: help is an option.", ["--help"]
    elif first and (near := _nearest(word, [*NAMES, *_options("experiment")])) in NAMES:
        yield f"{word}: there is no such command.", [near]
    elif near := _nearest(word, _options("experiment")):
        yield f"{word}: an experiment is added to the settings.", [f"+experiment={near}"]
    else:
        yield f"{word}: this is neither a command ({', '.join(NAMES)}) nor a setting (name=value). See --help.", [word]


def _option(name: str, value: str) -> Iterator[tuple[str, list[str]]]:
    """The fault of an unknown option of a group, and the nearest known one."""
    there = _options(name.lstrip("+"))
    if there and value not in (*there, "null") and not (CONF / name.lstrip("+") / value).with_suffix(".yaml").exists():
        near = _nearest(value, there)
        fault = f"{name}={value}: there is no such option"
        yield f"{fault}." if near else f"{fault}; there are {', '.join(there)}.", [f"{name}={near or value}"]


@cache
def _options(group: str) -> tuple[str, ...]:
    """Options of a group."""
    return tuple(sorted(file.stem for file in (CONF / group).glob("*.yaml")))


@cache
def _groups() -> tuple[str, ...]:
    """Groups of settings."""
    return tuple(sorted(folder.name for folder in CONF.iterdir() if folder.is_dir() and folder.name[0] != "_"))


@cache
def _settings() -> tuple[str, ...]:
    """Settings of no group, and blocks that a group or an experiment brings, by their first names."""
    files = (CONF / "config.yaml", *(CONF / "experiment").glob("*.yaml"))
    text = "\n".join(file.read_text(encoding="utf-8") for file in files)
    return tuple(dict.fromkeys(re.findall(r"^(\w+):", text, re.M) + re.findall(r"- \w+@(\w+):", text)))


def _nearest(word: str, known: Sequence[str]) -> str:
    """The name that is most like a word, whatever its capitals; empty if none is."""
    lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), lower, 1)
    return lower[near[0]] if near else ""
