"""Mistakes that people make on the command line, each answered by the command that was meant, before Hydra sees it."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from stringcast.pipeline.called import called_as
from stringcast.pipeline.commands import NAMES
from stringcast.pipeline.settings import CONF, UserError

FLAGS = ("-m", "--multirun", "-v", "-h", "--help")
FROM_TRIALS = ("estimate", "diagnose", "decide")  # experiments that look at stored trials
IN_METRES = re.compile(r"(string\.length|(?:target|arm\.base|obstacles)\.[\w.]+)=(-?[\d.]+)$")
FARTHEST = 5.0  # [m] that no string, target or arm here reaches; from there on a number is in millimetres


def refuse_mistakes(words: Sequence[str]) -> None:
    """Raise UserError for the first word that is not what it is meant for, with the command to paste instead."""
    for fault, better in _found(words):
        raise UserError(f"{fault} Try: {called_as()} {shlex.join(better)}" if better else fault)


def _found(words: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Mistakes, and all words as they were meant."""
    before, after = list(words), list(words)
    for place, word in enumerate(words):
        for fault, meant in _of(word, words[place + 1 :], first=place == 0):
            taken = 2 if word == "--experiment" else 1
            after[place : place + taken] = meant
            yield fault, after if after != before else []
    experiment = next((word.removeprefix("+experiment=") for word in words if word.startswith("+experiment=")), "")
    if experiment in FROM_TRIALS and not any(word.startswith("trials=") for word in words):
        yield f"+experiment={experiment} looks at stored trials, and none are named.", [*words, "trials=data/sample"]


def _of(word: str, following: Sequence[str], first: bool) -> Iterator[tuple[str, list[str]]]:
    """What is wrong with a word, and what stands for it."""
    name, given, value = word.partition("=")
    if word == "--experiment" and following:
        yield "an experiment is added to the settings.", [f"+experiment={following[0]}"]
    elif name in ("experiment", "--experiment") and given:
        yield f"{word}: an experiment is added to the settings.", [f"+experiment={value}"]
    elif word in FLAGS or word.startswith(("-", "~")):  # ~ takes a setting out
        return
    elif name == "steps" and given:
        yield f"{word}: what a run does is its mode now.", [f"mode={_mode(value)}"]
    elif not given:
        yield from _bare(word, first)
    elif (CONF / name.lstrip("+")).is_dir() and value and not re.search(r"[,()\[{$]", value):
        yield from _option(name, value)
    elif (found := IN_METRES.match(word)) and abs(float(found[2])) > FARTHEST:
        yield f"{word}: lengths are in metres.", [f"{name}={float(value) / 1e3:g}"]


def _mode(steps: str) -> str:
    """The mode that did what these steps did, as older versions called it: `[estimate]`, `[extract,diagnose]`."""
    names = steps.strip("[]").replace(" ", "").split(",")
    last = {"study": "blind_study", "extract": "cast"}.get(names[-1], names[-1])
    return "cast" if "generate" in names else "decide" if "execute" in names else last


def _bare(word: str, first: bool) -> Iterator[tuple[str, list[str]]]:
    """Of a word that sets nothing."""
    if Path(word).is_dir():
        yield f"{word}: a folder of trials is a setting.", [f"trials={word}"]
    elif first and (near := _nearest(word, [*NAMES, *_options("experiment")])) in NAMES:
        yield f"{word}: there is no such command.", [near]
    elif near := _nearest(word, _options("experiment")):
        yield f"{word}: an experiment is added to the settings.", [f"+experiment={near}"]
    else:
        yield f"{word}: this is neither a command ({', '.join(NAMES)}) nor a setting (name=value). See --help.", [word]


def _option(name: str, value: str) -> Iterator[tuple[str, list[str]]]:
    """Of a group of settings with an option that there is none of."""
    there = _options(name.lstrip("+"))
    if there and value not in (*there, "null") and not (CONF / name.lstrip("+") / value).with_suffix(".yaml").exists():
        near = _nearest(value, there)
        fault = f"{name}={value}: there is no such option; there are {', '.join(there)}."
        yield fault, [f"{name}={near}" if near else f"{name}={value}"]


@cache
def _options(group: str) -> tuple[str, ...]:
    """Options of a group."""
    return tuple(sorted(file.stem for file in (CONF / group).glob("*.yaml")))


def _nearest(word: str, known: Sequence[str]) -> str:
    """The name that is most like a word, whatever its capitals; empty if none is."""
    lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), lower, 1)
    return lower[near[0]] if near else ""
