"""Casts before those that count: all methods of a study learn from them, and a diagnosis makes a model of them."""

from __future__ import annotations

from typing import Any

import yaml

from stringcast.data.artifacts import Diagnosis
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.hitting.desk import PointExecutor
from stringcast.pipeline.run import Iteration
from stringcast.pipeline.steps import Past

PERFORMED = ("generate", "execute", "extract")


def lessons(desk: PointExecutor, count: int) -> list[Iteration]:
    """First casts, each as if nothing were known of the string; what is cast after them is no change of theirs."""
    casts = [Iteration(number, {}) for number in range(1, count + 1)]
    for current in casts:
        for name in PERFORMED:
            current.done[name] = desk.step(name, Past(current.number, current.done, None, None, ()))
        del current.done["generate"]
    return casts


def estimated(desk: PointExecutor, casts: list[Iteration]) -> None:
    """What the desk's method makes of all lessons is known after the last."""
    last = casts[-1]
    last.done["estimate"] = desk.step("estimate", _seen(casts))


def model_found(here: Experiment, casts: list[Iteration]) -> dict[str, Any]:
    """Settings of the model that a diagnosis of the lessons makes: what `extended=<its folder>` brings along."""
    made: Diagnosis = PointExecutor(here, noise=0.0).step("diagnose", _seen(casts))
    said: dict[str, Any] = yaml.safe_load(made.finding["extended"].iloc[0])
    return said


def _seen(casts: list[Iteration]) -> Past:
    return Past(casts[-1].number, casts[-1].done, None, None, tuple(cast.observation for cast in casts))
