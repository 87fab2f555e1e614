"""Cast until the measured tip hits the box or the budget is spent (II-A)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stringcast.data.artifacts import Motion, Points, TrialSet
from stringcast.pipeline.modes.stepwise import Stepwise, refuse_trials
from stringcast.pipeline.run.experiment import ALL_TRIALS, Experiment
from stringcast.pipeline.run.iterations import Executor, History, Iteration
from stringcast.pipeline.run.result import RunResult
from stringcast.pipeline.settings.allowed_callables import DRY_RUNS
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.stage_registry import stages
from stringcast.pipeline.settings.typed_settings import require_allowed
from stringcast.stages.align.correction import transform_to_arm_frame
from stringcast.stages.hit_test import check_reach, hit_test

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cast(Stepwise):
    """Repeated casts.

    Parameters
    ----------
    stages : tuple of str
        Stages of each cast, in order.
    """

    stages: tuple[str, ...]

    def check(self, experiment: Experiment) -> None:
        refuse_trials(experiment)
        refuse_unknown_stages(self.stages)
        check_reach(experiment.target, experiment.arm, experiment.string.length)

    def moves_arm(self, config: Mapping[str, Any]) -> bool:
        return config["trials"] is None and "execute" in self.stages

    def run_steps(
        self,
        experiment: Experiment,
        folder: Path,
        executor: Executor,
        before: Sequence[Iteration] = (),
    ) -> RunResult:
        """Cast until a trial hits; earlier casts count."""
        history = History(executor, [*before])
        by = require_allowed(
            experiment.config["execute"]["_target_"], "execute", "config.json"
        )
        dry = by in DRY_RUNS
        casts = 1 if dry else experiment.config["max_casts"]
        while len(history.iterations) < casts and not (
            history.iterations and history.iterations[-1].has_hit
        ):
            current = history.begin_iteration()
            for name in self.stages:
                if "trials" not in stages()[name].inputs:
                    history.make_artifact(name)
                # nothing is learned from a trial that cannot be trusted
                elif not current.refusal_reason:
                    history.make_artifact(
                        name,
                        trials=trials_for_estimation(experiment, history.iterations),
                    )
            log_fit(current)
            # whether it hit is asked of the tip as it was measured
            motion: Motion = current.artifacts["motion"]
            points: Points = current.artifacts["points"]
            there = transform_to_arm_frame(points, experiment.model)
            verdict = hit_test(
                there, experiment.target, experiment.obstacles, motion.duration
            )
            log.info(
                "cast %d: the tip came within %.1f mm of the target",
                current.number,
                1e3 * verdict.distance,
            )
            if current.refusal_reason:
                log.warning(
                    "cast %d: nothing is estimated from its trial: %s",
                    current.number,
                    current.refusal_reason,
                )
            history.iterations[-1] = replace(current, verdict=verdict)
            executor.publish(history.iterations)
        made = tuple(history.iterations)
        return RunResult(
            folder, made, dry_run_outcome(made[-1]) if dry else cast_outcome(made)
        )


def refuse_unknown_stages(names: Sequence[str]) -> None:
    """Raise UserError for a name that no stage has."""
    for name in names:
        if name not in stages():
            raise UserError(
                f"mode: there is no stage {name!r}. Known are: {', '.join(stages())}."
            )


def trials_for_estimation(
    experiment: Experiment, iterations: Sequence[Iteration]
) -> TrialSet:
    """Return the trusted trials that an estimation uses: the last ones, or all."""
    seen = [i for i in iterations if "points" in i.artifacts and not i.refusal_reason]
    used = experiment.config["trials_used"]
    last = seen if used == ALL_TRIALS else seen[-used:]
    return TrialSet(
        tuple(i.observation for i in last),
        iteration_numbers=tuple(i.number for i in last),
    )


def log_fit(iteration: Iteration) -> None:
    """Log the result of an estimation, if there was one."""
    if "estimate" not in iteration.artifacts:
        return
    fit = iteration.artifacts["estimate"].fit.iloc[0]
    rate, off = fit[["before", "after"]], 1e3 * fit[["rms_before", "rms_after"]]
    words = "estimate %d: E %.3f to %.3f, rms %.1f to %.1f mm. %s"
    log.info(words, iteration.number, *rate, *off, fit["sentence"])


def cast_outcome(iterations: Sequence[Iteration]) -> str:
    """Describe the outcome of the casts in a sentence."""
    last = iterations[-1]
    if last.has_hit:
        return f"The tip reached the target in cast {last.number}."
    tries = f"{len(iterations)} cast{'s' if len(iterations) > 1 else ''}"
    return f"The tip did not reach the target in {tries}; the budget is spent."


def dry_run_outcome(iteration: Iteration) -> str:
    """Describe a dry run: the delays of the link, and how often the string was read."""
    link, read = (
        iteration.artifacts["trial"].link.iloc[0],
        iteration.artifacts["points"].readings["valid"],
    )
    unread = iteration.artifacts["points"].readings.loc[~read.astype(bool), "reason"]
    why = f" (most often: {unread.mode().iloc[0]})" if len(unread) else ""
    parts = [
        f"commands went out {link['jitter_p50'] * 1e3:.2f} ms late (99 %: {link['jitter_p99'] * 1e3:.2f})",
        f"{link['missed']} of {link['ticks']} were late or lost",
        f"the string was read in {int(read.sum())} of {len(read)} frames{why}",
    ]
    if "trip_p50" in link:  # which a virtual arm has none of
        parts.insert(
            0,
            f"a round trip takes {link['trip_p50'] * 1e3:.2f} ms (99 %: {link['trip_p99'] * 1e3:.2f})",
        )
    return f"Dry run: {', '.join(parts)}. Nothing is learned from it: {iteration.refusal_reason}."
