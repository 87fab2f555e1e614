"""The loop: iterate until the real tip is in the box or the budget is spent (II-A).

The order of the steps, and what each may look at. Where they are made, or only looked up, is the desk's affair: a run
makes and keeps them (`pipeline.run_folder`), `verify` computes them again, `why` asks what has changed.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any, Protocol

from stringcast.data import dataset
from stringcast.data.alignment import Alignment
from stringcast.data.artifacts import MASKS, POINTS, READINGS, Diagnosis, Estimate, Motion, Observation, Points
from stringcast.data.schema import DataError
from stringcast.pipeline.experiment import ALL, Experiment
from stringcast.pipeline.settings import allowed
from stringcast.pipeline.steps import Past
from stringcast.pipeline.targets import REHEARSALS
from stringcast.stages.align.undo import in_arms_frame
from stringcast.stages.check.check import refuse
from stringcast.stages.check.measured import Measured
from stringcast.stages.hit_test import Verdict, hit_test

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Iteration:
    """One manipulation: its artifacts by step, and whether the tip hit."""

    number: int
    done: dict[str, Any] = field(repr=False)
    verdict: Verdict | None = None

    @property
    def name(self) -> str:
        """Name of its trial, which no stored one has where it was proposed by a diagnosis of those."""
        return f"performed-{self.number:02d}" if "propose" in self.done else f"t{self.number:02d}"

    @property
    def refused(self) -> str:
        """Why nothing is learned from its trial; empty if it can be trusted."""
        link = self.done["execute"].link.iloc[0] if "execute" in self.done else {"valid": True}
        return "" if link["valid"] else str(link["reason"])

    @property
    def hit(self) -> bool:
        """Whether the tip reached the target in a trial that can be trusted."""
        return self.verdict is not None and self.verdict.hit and not self.refused

    @property
    def observation(self) -> Observation:
        """Its trial as estimation sees it."""
        trial, points = self.done["execute"], self.done["extract"]
        return Observation(self.name, points.points, points.readings, points.masks, arm=trial.arm)


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    folder: Path
    iterations: tuple[Iteration, ...]
    sentence: str

    @property
    def diagnosis(self) -> Diagnosis | None:
        """What was found, if it was asked."""
        return self.iterations[-1].done.get("diagnose")

    @property
    def alignment(self) -> Alignment | None:
        """What was measured of camera and clock, if it was asked."""
        return self.iterations[-1].done.get("align")

    @property
    def estimate(self) -> Estimate | None:
        """The last one, if there is any."""
        return next((i.done["estimate"] for i in reversed(self.iterations) if "estimate" in i.done), None)

    @property
    def hit(self) -> bool:
        """Whether the real tip reached the target."""
        return any(i.hit for i in self.iterations)


class Executor(Protocol):
    """Where a run's steps come from."""

    def step(self, name: str, past: Past) -> Any:
        """The artifact of a step."""

    def publish(self, iterations: list[Iteration]) -> None:
        """Called whenever a cast is whole."""


def work(experiment: Experiment, folder: Path, desk: Executor) -> Result:
    """All that the settings ask for. folder: the run's."""
    if "align" in experiment.config["steps"]:
        return align(experiment, folder, desk)
    if experiment.config["trials"] is None:
        return cast(experiment, folder, desk)
    again = diagnose if "diagnose" in experiment.config["steps"] else estimate_again
    return again(experiment, folder, Path(experiment.config["trials"]), desk)


def cast(experiment: Experiment, folder: Path, desk: Executor, before: Sequence[Iteration] = ()) -> Result:
    """Cast until it hits or the manipulations are spent. before: what was cast already, and counts as spent."""
    iterations = list(before)
    rehearsal = allowed(experiment.config["execute"]["_target_"], "execute", "config.json") in REHEARSALS
    while len(iterations) < (1 if rehearsal else experiment.config["manipulations"]) and not (
        iterations and iterations[-1].hit
    ):
        iterations.append(_iterate(experiment, iterations, desk))
        desk.publish(iterations)
    return Result(folder, tuple(iterations), _rehearsed(iterations[-1]) if rehearsal else _ended(iterations))


def estimate_again(experiment: Experiment, folder: Path, trials: Path, desk: Executor) -> Result:
    """Estimation alone, from stored trials: each in turn, beginning with the one before it, or from all at once.

    Points are made from a trial's frames where it has no points, or where `steps` asks for it. Trials that dataset.yaml
    holds out are not estimated from: what the last estimate foretells of each comes after.
    """
    data = _usable(experiment, trials)
    aside = set(held_out(data))
    fitted = [stored for name, stored in data.trials.items() if name not in aside]
    if not fitted:
        raise DataError(f"trials={trials}: dataset.yaml holds out every trial. Leave some to estimate from.")
    iterations: list[Iteration] = []
    observations: list[Observation] = []
    last: Estimate | None = None
    for number, stored in enumerate(fitted, start=1):
        past = Past(number, {}, None, last, tuple(observations), data.films.get(stored.trial), _hashes(data))
        done, observation = _read_again(experiment, stored, past, desk)
        observations.append(observation)
        if number == len(fitted) or experiment.config["memory"] != ALL:
            last = desk.step("estimate", replace(past, done=done, observations=_remembered(experiment, observations)))
            done = done | {"estimate": last}
        iterations.append(Iteration(number, done))
        _told(iterations[-1])
    for number, name in enumerate(sorted(aside & data.trials.keys()), start=len(fitted) + 1):
        past = Past(number, {}, None, last, (), data.films.get(name), _hashes(data))
        done, observation = _read_again(experiment, data.trials[name], past, desk)
        made = desk.step("predict", replace(past, done=done, observations=(observation,)))
        iterations.append(Iteration(number, done | {"predict": made}))
    return Result(folder, tuple(iterations), _estimated(iterations, data))


def _estimated(iterations: Sequence[Iteration], data: dataset.Dataset) -> str:
    """What estimation from stored trials came to, in a sentence or three."""
    estimates = [i.done["estimate"] for i in iterations if "estimate" in i.done]
    foretold = [i.done["predict"].score.iloc[0] for i in iterations if "predict" in i.done]
    count, rate = len(iterations) - len(foretold), float(estimates[-1].fit["after"].iloc[0])
    words = [f"Estimated from {count} trial(s) of {data.folder.name}; the matching rate E is {rate:.3f}."]
    words += [f"Held out, the tip of {s['trial']} is {1e3 * s['tip']:.1f} mm off (rms)." for s in foretold]
    words += [f"Left out: {_reasons(data.rejected)}."] if data.rejected else []
    return " ".join(words)


def _remembered(experiment: Experiment, observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """Those of the trials that an estimation looks at: the last ones, or all."""
    memory = experiment.config["memory"]
    return tuple(observations if memory == ALL else observations[-memory:])


def diagnose(experiment: Experiment, folder: Path, trials: Path, desk: Executor) -> Result:
    """The diagnosis of stored trials.

    Where `steps` says that the arm may move: while look-alikes are left that a motion tells apart, that motion is
    performed, and diagnosed with all the others, `manipulations` times at most.
    """
    data = _usable(experiment, trials)
    observations: list[Observation] = []
    iterations: list[Iteration] = []
    for number, stored in enumerate(data.trials.values(), start=1):
        past = Past(number, {}, None, None, tuple(observations), data.films.get(stored.trial), _hashes(data))
        done, observation = _read_again(experiment, stored, past, desk)
        observations.append(observation)
        iterations.append(Iteration(number, done))
    past = replace(past, observations=tuple(observations), rejected=data.rejected, held_out=held_out(data))
    motions = experiment.config["manipulations"] if "execute" in experiment.config["steps"] else 0
    past = _diagnosed(past, iterations[-1], desk)
    while len(iterations) < len(observations) + motions and past.diagnosis is not None and past.diagnosis.motion:
        iterations.append(Iteration(past.number + 1, {}))
        past = _performed(past, iterations[-1], desk)
        past = _diagnosed(past, iterations[-1], desk)
        desk.publish(iterations[len(observations) :])
    return Result(folder, tuple(iterations), _concluded(past))


def align(experiment: Experiment, folder: Path, desk: Executor) -> Result:
    """Camera and clock measured from stored trials, or where there are none from a motion performed for it."""
    current = Iteration(1, {})
    past = Past(1, current.done, None, None, ())
    if experiment.config["trials"] is None:
        past = _excited(past, current, desk)
    else:
        data = _usable(experiment, Path(experiment.config["trials"]))
        seen = tuple(data.trials.values())
        past = replace(past, observations=seen, films=data.films, rejected=data.rejected, hashes=_hashes(data))
    made: Alignment = desk.step("align", past)
    current.done["align"] = made
    left = f"Left out: {_reasons(past.rejected)}." if past.rejected else ""
    return Result(folder, (current,), " ".join(filter(None, (made.sentence, left))))


def _excited(past: Past, current: Iteration, desk: Executor) -> Past:
    """Perform the motion that tells the most. Raises DataError where its trial cannot be trusted."""
    for name in ("excite", "execute"):
        current.done[name] = desk.step(name, past)
    if current.refused:
        raise DataError(f"nothing is measured from this trial: {current.refused}.")
    trial = current.done["execute"]
    seen = Observation(current.name, POINTS.empty(), READINGS.empty(), MASKS.empty(), arm=trial.arm)
    return replace(past, observations=(seen,), films={current.name: trial.film})


def _diagnosed(past: Past, current: Iteration, desk: Executor) -> Past:
    """Diagnose all that is there, and leave the motion that comes next, if there is one."""
    made: Diagnosis = desk.step("diagnose", past)
    current.done["diagnose"] = made
    past = replace(past, done=current.done, diagnosis=made)
    if made.motion:
        desk.step("propose", replace(past, number=past.number + 1))
    return past


def _performed(past: Past, current: Iteration, desk: Executor) -> Past:
    """Perform the motion that the last diagnosis proposed; what was seen joins the other trials."""
    past = replace(past, number=current.number, done=current.done, film=None)
    for name in ("propose", "execute", "extract"):
        current.done[name] = desk.step(name, past)
    fault = _fault(current)
    if fault:
        return replace(past, rejected={**past.rejected, current.name: fault})
    return replace(past, observations=(*past.observations, current.observation))


def _fault(current: Iteration) -> str:
    """Why a trial just performed cannot be used; empty if it can."""
    read = current.done["extract"].readings["valid"].any()
    return current.refused or ("" if read else "the string could not be read in any frame")


def _concluded(past: Past) -> str:
    """The verdict, what was left out, and what to do next."""
    assert past.diagnosis is not None
    found = json.loads(past.diagnosis.finding["diagnosis"].iloc[0])
    rejected, following = found["trials"]["rejected"], found["next_experiment"]
    left = f"Left out: {_reasons(rejected)}." if rejected else ""
    return " ".join(filter(None, (past.diagnosis.sentence, left, following and following["sentence"])))


def _hashes(data: dataset.Dataset) -> dict[str, str]:
    """Of the files of stored trials, by path."""
    return {(data.folder / name).as_posix(): digest for name, digest in data.hashes.items()}


def held_out(data: dataset.Dataset) -> tuple[str, ...]:
    """Trials that dataset.yaml sets aside."""
    return tuple(name for name, about in data.about.get("trials", {}).items() if about.get("role") == "held_out")


def _usable(experiment: Experiment, trials: Path) -> dataset.Dataset:
    """Stored trials that fit this string; raises DataError where there are none."""
    read = dataset.read(trials)
    refuse(Measured(read, experiment.arm, experiment.camera, experiment.string.length))
    data = dataset.fits(read, experiment.string.length)
    if not data.trials:
        reasons = _reasons(data.rejected) or "it holds no trial"
        raise DataError(f"trials={trials}: no trial can be used ({reasons}). Look at the files it names.")
    return data


def _reasons(rejected: Mapping[str, str]) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in rejected.items())


def _read_again(
    experiment: Experiment, stored: Observation, past: Past, desk: Executor
) -> tuple[dict[str, Any], Observation]:
    """What was extracted, if anything was, and the observation with its points."""
    asked = experiment.config["steps"][0] == "extract"
    if past.film is None or not (stored.points.empty or asked):
        return {}, stored
    points = desk.step("extract", past)
    return {"extract": points}, replace(stored, points=points.points, readings=points.readings, masks=points.masks)


def _iterate(experiment: Experiment, before: list[Iteration], desk: Executor) -> Iteration:
    """One manipulation, step by step. Nothing is estimated from a trial that cannot be trusted."""
    current = Iteration(len(before) + 1, {})
    estimates = [i.done["estimate"] for i in before if "estimate" in i.done]
    for name in experiment.config["steps"]:
        if name == "estimate" and current.refused:
            continue
        seen = [i for i in (*before, current) if "extract" in i.done and not i.refused]
        past = Past(
            current.number,
            current.done,
            before[-1].done.get("generate") if before else None,
            estimates[-1] if estimates else None,
            _remembered(experiment, [i.observation for i in seen]),
        )
        current.done[name] = desk.step(name, past)
    if "estimate" in current.done:
        _told(current)
    motion: Motion = current.done["generate"]
    points: Points = current.done["extract"]
    there = in_arms_frame(points, experiment.model)
    verdict = hit_test(there, experiment.target, experiment.obstacles, motion.duration)
    log.info("cast %d: the tip came within %.1f mm of the target", current.number, 1e3 * verdict.distance)
    if current.refused:
        log.warning("cast %d: nothing is estimated from its trial: %s", current.number, current.refused)
    return Iteration(current.number, current.done, verdict)


def _told(iteration: Iteration) -> None:
    """Note how an estimation went, if there was one."""
    if "estimate" not in iteration.done:
        return
    fit = iteration.done["estimate"].fit.iloc[0]
    rate, off = fit[["before", "after"]], 1e3 * fit[["rms_before", "rms_after"]]
    words = "estimate %d: E %.3f to %.3f, rms %.1f to %.1f mm. %s"
    log.info(words, iteration.number, *rate, *off, fit["sentence"])


def _ended(iterations: list[Iteration]) -> str:
    """How casting ended, in a sentence."""
    last = iterations[-1]
    if last.hit:
        return f"The tip reached the target in manipulation {last.number}."
    tries = f"{len(iterations)} manipulation{'s' if len(iterations) > 1 else ''}"
    return f"The tip did not reach the target in {tries}; the budget is spent."


def _rehearsed(iteration: Iteration) -> str:
    """What a rehearsal shows: how the link carries the ticks, and whether the string can be read."""
    link, read = iteration.done["execute"].link.iloc[0], iteration.done["extract"].readings["valid"]
    unread = iteration.done["extract"].readings.loc[~read.astype(bool), "reason"]
    why = f" (most often: {unread.mode().iloc[0]})" if len(unread) else ""
    told = [
        f"commands went out {link['jitter_p50'] * 1e3:.2f} ms late (99 %: {link['jitter_p99'] * 1e3:.2f})",
        f"{link['missed']} of {link['ticks']} were late or lost",
        f"the string was read in {int(read.sum())} of {len(read)} frames{why}",
    ]
    if "trip_p50" in link:  # which a virtual arm has none of
        told.insert(0, f"a round trip takes {link['trip_p50'] * 1e3:.2f} ms (99 %: {link['trip_p99'] * 1e3:.2f})")
    return f"Rehearsed: {', '.join(told)}. Nothing is learned from it: {iteration.refused}."


def in_numbers(result: Result) -> dict[str, Any]:
    """The run in a few numbers: run.json."""
    rows = []
    for i in result.iterations:
        fit = i.done["estimate"].fit.iloc[0] if "estimate" in i.done else {}
        row = {"number": i.number, "E_before": fit.get("before"), "E_after": fit.get("after")}
        row |= {"rms_m": fit.get("rms_after"), "tip_rms_m": fit.get("tip_after")}
        if "predict" in i.done:
            score = i.done["predict"].score.iloc[0]
            row |= {"held_out": score["trial"], "rms_m": score["rms"], "tip_rms_m": score["tip"]}
        if i.verdict is not None:
            row |= {"hit": i.hit, "miss_m": i.verdict.distance, "t_closest": i.verdict.t}
            row |= {"touched": i.verdict.touched}
        row = {name: None if isinstance(value, float) and not isfinite(value) else value for name, value in row.items()}
        rows.append(row)
    return {"hit": result.hit, "sentence": result.sentence, "iterations": rows}
