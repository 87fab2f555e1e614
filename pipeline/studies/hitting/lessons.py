"""Casts before those that count: all methods of a study learn from them, and a diagnosis makes a model of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import yaml

from stringcast.data.artifacts import Diagnosis, TrialSet
from stringcast.pipeline.experiment import Experiment
from stringcast.pipeline.iterations import History, Iteration
from stringcast.pipeline.studies.hitting.executor import PointExecutor

PERFORMED = ("generate", "execute", "extract")


def lessons(executor: PointExecutor, count: int) -> list[Iteration]:
    """First casts, each as if nothing were known of the string; what is cast after them is no change of theirs."""
    history = History(executor)
    for _ in range(count):
        current = history.begin()
        for name in PERFORMED:
            history.make(name)
        del current.done["motion"]
    return history.iterations


def estimated(executor: PointExecutor, casts: list[Iteration]) -> None:
    """What the executor's method makes of all lessons is known after the last."""
    History(executor, casts).make("estimate", trials=_seen(casts))


def model_found(here: Experiment, casts: list[Iteration]) -> dict[str, Any]:
    """Settings of the model that a diagnosis of the lessons makes: what `extended=<its folder>` brings along."""
    taught = [*casts[:-1], replace(casts[-1], done=dict(casts[-1].done))]
    made: Diagnosis = History(PointExecutor(here, noise=0.0), taught).make("diagnose", trials=_seen(casts))
    said: dict[str, Any] = yaml.safe_load(made.finding["extended"].iloc[0])
    return said


def _seen(casts: list[Iteration]) -> TrialSet:
    return TrialSet(tuple(cast.observation for cast in casts))
