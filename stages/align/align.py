"""Align: how the camera and its clock stand to the arm, measured from a motion that
both saw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
import pandas as pd
import yaml
from pydantic import Field

from stringcast.data.alignment import (
    ALIGNMENT_SUMMARY,
    MEASURED_PARAMETERS,
    SIGHTINGS,
    Alignment,
)
from stringcast.data.artifacts import Film, Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.stages.align.acceptance import max_hand_speed, refuse_fit, refuse_sight
from stringcast.stages.align.fit import (
    CANDIDATE_EFFECTS,
    REQUIRED_EFFECTS,
    AlignmentFit,
    AlignmentProblem,
    add_effects,
    measurement_model,
    select_effects,
)
from stringcast.stages.align.grasp import grasp_sightings
from stringcast.stages.align.lookalike import (
    LAG,
    OFFSET,
    largest_hidden_lag,
    likelihood_profile,
)
from stringcast.stages.align.outline import sightings_from_films
from stringcast.stages.common import Progress, rms
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.spec import StageCall

TARGET_PRECISION = 1e-3  # [s] to which the clocks should be known


def run(call: StageCall, trials: TrialSet) -> Alignment:
    """The alignment in all trials, as a stage."""
    made: Alignment = call.by(
        call.setup.model, trials.observations, trials.films, progress=call.progress
    )
    return made


def align(
    model: Model,
    observations: Sequence[Observation],
    films: Mapping[str, Film],
    *,
    arm_width: Annotated[float, Field(gt=0)],
    progress: Progress = lambda share: None,
) -> Alignment:
    """The alignment of camera and arm in all trials together.

    films: of trials that were filmed, by name: in these the arm's outline is read; of
    others the points at the grasp are taken. arm_width: of the links [m]. Raises
    DataError where the data cannot tell, with the reason.
    """
    if not observations:
        raise DataError(
            "there is no trial that can be used. Look at the reasons given for each."
        )
    full = measurement_model(model)
    filmed = {name: film for name, film in films.items() if film.arm is not None}
    seen = (
        sightings_from_films(
            full, filmed, arm_width, lambda share: progress(0.6 * share)
        )
        if filmed
        else ()
    )
    by_points = tuple(
        grasp_sightings(o, model.arm) for o in observations if o.trial not in filmed
    )
    problem = AlignmentProblem(
        full,
        tuple(trial for trial in (*seen, *by_points) if len(trial.sightings.frame)),
    )
    refuse_sight(problem)
    fit = select_effects(problem)
    progress(0.8)
    refuse_fit(problem, fit)
    return build_alignment(model, problem, fit)


def build_alignment(
    model: Model, problem: AlignmentProblem, fit: AlignmentFit
) -> Alignment:
    """The artifact of a fit: parameters with their ranges, sightings before and after,
    and the sentence.
    """
    alike = likelihood_profile(problem, fit)
    lag = largest_hidden_lag(alike, fit)
    measured = measured_table(problem, fit, lag)
    before = problem.residuals(
        problem.parameters(REQUIRED_EFFECTS),
        np.zeros((1, len(problem.parameters(REQUIRED_EFFECTS)))),
    )[0]
    after = fit.residual * problem.sigma

    # the model with the alignment, as settings that other experiments take
    ours = {*REQUIRED_EFFECTS, *CANDIDATE_EFFECTS}
    others = [
        e.name
        for e in model.effects
        if "." in (e.qualified_name(e.parameters[0]) if e.parameters else ".")
    ]
    known: dict[str, object] = {
        n: v for n, v in model.start_values.items() if n.split(".")[0] not in ours
    }
    for found in measured[measured["found"]].itertuples():
        known[found.name] = {"value": found.value, "low": found.low, "high": found.high}
    effects = sorted({*others, *fit.effects} - {"gravity"} - (ours - {*fit.effects}))

    row = {
        "sentence": alignment_sentence(measured, fit, lag),
        "rms_before": rms(before),
        "rms_after": rms(after),
        "noise": rms(problem.sigma),
        "speed": max(max_hand_speed(model.arm, trial) for trial in problem.trials),
        "most_lag": lag,
        "extended": yaml.safe_dump(
            {"effects": effects, "parameter_values": known}, sort_keys=False
        ),
    }
    parts = []
    for trial in problem.trials:
        s = trial.sightings
        columns = {
            "trial": trial.name,
            "t": s.times[s.frame],
            "link": s.link,
            "share": s.share,
            "sigma": s.sigma,
        }
        columns |= dict(
            zip(
                ("x", "y", "along_x", "along_y"),
                (*s.position.T, *s.direction.T),
                strict=True,
            )
        )
        parts.append(pd.DataFrame(columns))
    seen = SIGHTINGS.check(
        pd.concat(parts, ignore_index=True).assign(before=before, after=after)
    )
    return Alignment(
        measured, seen, alike, ALIGNMENT_SUMMARY.check(pd.DataFrame([row]))
    )


def measured_table(
    problem: AlignmentProblem, fit: AlignmentFit, lag: float
) -> pd.DataFrame:
    """Table MEASURED. An interval holds whether what was looked for and not seen is
    there unseen or not, but for a lag.

    lag: up to which one would not be seen [s].
    """
    others = [
        name for name in CANDIDATE_EFFECTS if name not in (*fit.effects, "arm_lag")
    ]
    free = add_effects(problem, fit, *others)
    ends = {
        name: (x, x - r, x + r)
        for name, x, r in zip(free.names, free.x, free.half_widths, strict=True)
    }
    own = {
        name: (x, x - r, x + r)
        for name, x, r in zip(fit.names, fit.x, fit.half_widths, strict=True)
    }
    ends |= {
        n: (x, min(low, ends[n][1]), max(high, ends[n][2]))
        for n, (x, low, high) in own.items()
    }
    if "arm_lag" not in fit.effects:
        ends[LAG] = (0.0, 0.0, lag)
    known = {p.name: p for p in problem.model.parameters}
    ends = {
        n: (x, max(low, known[n].low), min(high, known[n].high))
        for n, (x, low, high) in ends.items()
    }
    rows = [
        {
            "name": name,
            "unit": known[name].unit,
            "meaning": known[name].meaning,
            "found": name in fit.names,
        }
        | dict(zip(("value", "low", "high"), numbers, strict=True))
        for name, numbers in ends.items()
    ]
    return MEASURED_PARAMETERS.check(
        pd.DataFrame(rows).sort_values(["found", "name"], ascending=[False, True])
    )


def alignment_sentence(measured: pd.DataFrame, fit: AlignmentFit, lag: float) -> str:
    """The result of an alignment in sentences: what was measured, and what it cannot be
    told from.
    """
    rows = measured.set_index("name")
    said, agreed = [], []
    for effect in find_effects(fit.effects):
        ends = rows.loc[
            [effect.qualified_name(p) for p in effect.parameters], ["low", "high"]
        ].to_numpy()
        if (ends[:, 0] <= 0).all() and (ends[:, 1] >= 0).all():
            agreed.append(effect.name)
            continue
        words = effect.describe(
            {p.name: fit.values[effect.qualified_name(p)] for p in effect.parameters}
        )
        said.append(words[0].upper() + words[1:])
    if agreed:
        said.append(f"Nothing is off, within the intervals, in {', '.join(agreed)}")
    reach = float(rows.loc[OFFSET, "high"] - rows.loc[OFFSET, "low"]) / 2
    clocks = f"The clocks are compared to +- {1e3 * reach:.2f} ms (95 %)"
    clocks += (
        "."
        if reach < TARGET_PRECISION
        else f", which is more than the {1e3 * TARGET_PRECISION:.0f} ms that are aimed at."
    )
    alike = (
        f" An arm that lags by up to {1e3 * lag:.1f} ms would look the same in this motion, with clocks that much "
        "further apart: only the two together are measured."
    )
    return f"{'. '.join(said)}. {clocks}{alike if lag else ''}"
