"""The diagnosis: from trials and a model to a verdict with its evidence."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated

import numpy as np
import pandas as pd
import yaml
from pydantic import Field

from stringcast.data.artifacts import FINDING, HELD_OUT, MISSING, Diagnosis, Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.stages.common import Progress, part
from stringcast.stages.diagnose import tables
from stringcast.stages.diagnose.casts import Design
from stringcast.stages.diagnose.choose import chosen, levelled, noisiness
from stringcast.stages.diagnose.describe import document, sentence
from stringcast.stages.diagnose.differing import differing
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit, fitted
from stringcast.stages.diagnose.gain import configured, extended_settings, held_out_table, side
from stringcast.stages.diagnose.grain import grain
from stringcast.stages.diagnose.hypotheses import Causes, Hypotheses
from stringcast.stages.diagnose.leads import astray, beginnings, follow
from stringcast.stages.diagnose.missing import Missing, missing, unexplained
from stringcast.stages.diagnose.noise import FAR, mismatch
from stringcast.stages.diagnose.prepare import Ground, cleaned_anew, literal, prepared
from stringcast.stages.diagnose.resolve import DOUBTFUL
from stringcast.stages.diagnose.separate import separated
from stringcast.stages.diagnose.single_effects.design import Proposal
from stringcast.stages.diagnose.single_effects.document import without_nan
from stringcast.stages.diagnose.single_effects.prepared import usable
from stringcast.stages.diagnose.verdict import RESOLUTION, Judgement, judged
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.estimate.untouched import untouched
from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import library
from stringcast.stages.model.model import Model
from stringcast.stages.spec import Call

log = logging.getLogger(__name__)

AGAIN = 20  # steps of a fit to other trials
NEAR = 16.0  # mean square over the noise; of what is further off than that, its number of mass points is the least
FEWEST = 4  # mass points, between which positions are read
DESIGN = 1  # keeps the chance of the design apart from that of the fits
OPENED = "What was set aside for measuring the gain ({}) shows what the others do not: it was looked at as well."
SCATTERED = "nearly all points are far from those just before and after: look at what followed the string"
ALONE = "causes can be sought in one trial only: what is found in it could not be checked on another"


def run(call: Call, trials: TrialSet) -> Diagnosis:
    """The diagnosis of all trials until their string touches an obstacle, as a stage."""
    setup = call.setup
    seen = [untouched(trial, setup.obstacles) for trial in trials.observations]
    given = (setup.model, seen, trials.rejected, trials.held_out, setup.obstacles)
    made: Diagnosis = call.by(*given, seed=call.seed, progress=call.progress)
    return made


def diagnose(
    model: Model,
    observations: Sequence[Observation],
    rejected: Mapping[str, str],
    held_out: Sequence[str],
    obstacles: Sequence[Box],
    *,
    seed: int,
    starts: Annotated[int, Field(ge=2)],
    matching: Matching,
    design: Design,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """What the model gets wrong in these trials, and why.

    rejected: trials that cannot be used, with the reason. held_out: names of trials that are kept for measuring the
    gain; where there are none, or they show what the others do not, each trial is left out in turn. starts: of the
    search for the base model's parameters. matching: how the matching rate E is counted. design: of the motion that
    would decide between look-alikes, which the obstacles must not be in the way of; nothing is moved here. Raises
    DataError where no trial can be used.
    """
    if model.string.points < FEWEST:
        raise DataError(f"string.points = {model.string.points}: a diagnosis needs {FEWEST} or more. Change it.")
    good, faults = usable(model, observations)
    rejected = {**rejected, **faults}
    if not good:
        raise _none_left(rejected)
    given = _Data(model, good, rejected, held_out, matching, library(), seed, starts)
    data, every = _begun(given, lambda share: progress(share / 3))
    ground, hypotheses, causes = _compared(every, data, lambda share: progress((1 + 2 * share) / 3))
    if data.rest and not causes and hypotheses.explained(causes) and _shows(ground):
        data = data.opened()
        ground, hypotheses, causes = _compared(every, data, lambda share: None)
    judgement = judged(hypotheses, causes, coarse(ground))
    log.info("verdict: %s", judgement.verdict)
    if len(data.kept) == 1 and judgement.verdict == "unknown":
        judgement = replace(judgement, verdict="insufficient", left=1.0)
    proposal = separated(hypotheses, judgement, obstacles, design, np.random.default_rng([seed, DESIGN]))
    return _written(hypotheses, ground, causes, judgement, data, proposal)


def _begun(data: _Data, progress: Progress) -> tuple[_Data, Ground]:
    """What is given, and what its diagnosis starts from, without trials whose points are scattered."""
    ground = data.ground(data.observations, progress)
    scattered = ground.scattered
    if not scattered:
        return data, ground
    data = data.without(scattered)
    return data, data.ground(data.observations)


def _none_left(rejected: Mapping[str, str]) -> DataError:
    reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected.items())
    return DataError(f"there is no trial that can be used ({reasons}). Look at the files it names.")


def _compared(ground: Ground, data: _Data, progress: Progress) -> tuple[Ground, Hypotheses, Causes]:
    """The causes chosen, and what they were chosen from.

    Where the model as it is configured is near to the data, and nearer than one whose mass points do not matter, they
    may come from another simulation of its kind: it is tried first, and the other only if it leaves something to be
    seen. Where that leaves something too, or needs several causes, other numbers of points are asked. What leaves
    least stands.
    """
    off = ground.configured.mean_square
    nearer = off < NEAR and off < ground.beside_noise
    kinds = [data.of_points(data.model.string.points), _as_it_is] if nearer else [_as_it_is]
    made: list[tuple[Ground, Hypotheses, Causes]] = []
    for number, kind in enumerate(kinds):
        made.append(_sought(ground, data, kind, part(progress, number, len(kinds) + 1)))
        if made[-1][1].explained(made[-1][2]):
            break
    _, hypotheses, causes = made[-1]
    if not hypotheses.explained(causes) or len(causes) > 1:
        points = grain(hypotheses.floor, hypotheses.tried[causes])
        if points and not (nearer and points == data.model.string.points):
            made.append(_sought(ground, data, data.of_points(points), lambda share: None))
    progress(1.0)
    return min(made, key=lambda one: _left(*one)) if len(made) > 1 else made[0]


def _sought(
    ground: Ground, data: _Data, kind: Callable[[Ground], Ground], progress: Progress
) -> tuple[Ground, Hypotheses, Causes]:
    """The causes that are chosen on the ground of a kind; chosen again where they say that points are no outliers."""
    each = kind(ground)
    hypotheses = _hypotheses(each, data)
    if astray(each):
        follow(hypotheses, partial(_early, data, kind))
    hypotheses, causes = chosen(hypotheses, progress)
    ground, hypotheses, causes = _cleaned(data, each, hypotheses, causes) if causes else (each, hypotheses, causes)
    other = levelled(hypotheses, causes)
    if other != causes:  # beside which nothing was sought
        hypotheses, causes = chosen(hypotheses, lambda share: None, other)
    return ground, hypotheses, causes


def _cleaned(data: _Data, ground: Ground, hypotheses: Hypotheses, causes: Causes) -> tuple[Ground, Hypotheses, Causes]:
    """Causes chosen again on points that are no outliers once these are known; as they are where there are few."""
    plain, fit = hypotheses.tried[frozenset()], hypotheses.tried[causes]
    anew = cleaned_anew(ground, hypotheses.floor.segments, plain, fit)
    if anew is None:
        return ground, hypotheses, causes
    evidence, floor = anew.evidence.only(data.kept), anew.undoubted.only(data.kept)
    fresh = hypotheses.on_other_evidence(evidence, floor, _base(anew, data), causes)
    fresh, found = chosen(fresh, lambda share: None)
    return (anew, fresh, found) if found else (ground, hypotheses, causes)


def _early(data: _Data, kind: Callable[[Ground], Ground], seconds: float) -> tuple[Ground, Hypotheses]:
    """Ground and hypotheses of the beginnings of all trials."""
    ground = kind(data.ground(beginnings(data.observations, seconds)))
    return ground, _hypotheses(ground, data)


def _as_it_is(ground: Ground) -> Ground:
    return ground


def _hypotheses(ground: Ground, data: _Data) -> Hypotheses:
    """With the base model fitted."""
    evidence, floor = ground.evidence.only(data.kept), ground.undoubted.only(data.kept)
    hypotheses = Hypotheses(evidence, evidence, floor, ground.model, data.library, data.seed)
    hypotheses.add(_base(ground, data))
    return hypotheses


def _base(ground: Ground, data: _Data) -> Fit:
    """The base model fitted to the trials that are kept."""
    return again(ground.evidence.only(data.kept), ground.base) if data.rest else ground.base


def _left(ground: Ground, hypotheses: Hypotheses, causes: Causes) -> float:
    """Mean square of what causes leave of all points once fitted to the noise alone [m2]: those left out are as far off
    as the nearest that are."""
    fit, floor, count = hypotheses.tried[causes], hypotheses.floor, ground.raw.points
    kept = again(floor, fit).mean_square
    noise = float(np.median(floor.sigma))
    return noise**2 * ((count - ground.outliers) * kept + ground.outliers * FAR**2 / 2) / count


@dataclass(frozen=True)
class _Data:
    """What was given. shown: trials that were set aside, and show what the others do not."""

    model: Model
    observations: Sequence[Observation]
    rejected: Mapping[str, str]
    held_out: Sequence[str]
    matching: Matching
    library: Mapping[str, type[Effect]]
    seed: int
    starts: int
    shown: tuple[str, ...] = ()

    def without(self, scattered: Sequence[str]) -> _Data:
        """Without trials whose points are scattered. Raises DataError where no other is left."""
        left = [o for o in self.observations if o.trial not in scattered]
        rejected = {**self.rejected, **dict.fromkeys(scattered, SCATTERED)}
        if not left:
            raise _none_left(rejected)
        return replace(self, observations=left, rejected=rejected)

    def opened(self) -> _Data:
        """With the trials that were set aside looked at as well."""
        return replace(self, held_out=(), shown=tuple(self.observations[i].trial for i in self.rest))

    def ground(self, observations: Sequence[Observation], progress: Progress = lambda share: None) -> Ground:
        """What a diagnosis of these starts from."""
        rng = np.random.default_rng(self.seed)
        return prepared(self.model, observations, self.library, rng, self.starts, progress)

    def of_points(self, points: int) -> Callable[[Ground], Ground]:
        """The ground with so many equal mass points."""
        return partial(literal, library=self.library, points=points)

    @cached_property
    def rest(self) -> list[int]:
        """Numbers of the trials that are set aside: none if that would leave none."""
        rest = [i for i, o in enumerate(self.observations) if o.trial in self.held_out]
        return rest if len(rest) < len(self.observations) else []

    @cached_property
    def kept(self) -> list[int]:
        """Numbers of the others."""
        return [i for i in range(len(self.observations)) if i not in self.rest]


def _shows(ground: Ground) -> bool:
    """Whether the base model fitted to all trials leaves something to be seen."""
    return mismatch(ground.evidence, ground.base.residual) > 0


def again(evidence: Evidence, fit: Fit) -> Fit:
    """The fit, to other trials."""
    return fitted(evidence, [fit.theory], [fit.chi], AGAIN)[0]


def coarse(ground: Ground) -> float:
    """Mean square of the residual with the configured number of mass points, over that with enough of them; 1 where
    the simulation is too uncertain everywhere to tell."""
    noise = (ground.base.residual * ground.evidence.sigma / ground.floor) ** 2
    trusted = ground.evidence.sigma < DOUBTFUL * ground.floor
    if not trusted.any():
        return 1.0
    return float(np.mean(ground.configured.residual[trusted] ** 2) / max(np.mean(noise[trusted]), 1e-12))


def _gained(hypotheses: Hypotheses, ground: Ground, causes: Causes, judgement: Judgement, data: _Data) -> pd.DataFrame:
    """Table HELD_OUT. Where too few mass points are what is wrong, that is what the base model has."""
    few = _few(judgement, causes)
    base = configured(ground, data.kept, data.rest) if few else side(hypotheses, ground, frozenset(), data.rest)
    extended, chance = (
        side(hypotheses, ground, causes, data.rest),
        noisiness(hypotheses.evidence, hypotheses.tried[causes]),
    )
    numbers = data.rest or data.kept
    return held_out_table(base, extended, numbers, ground.floor, chance, data.observations, data.matching)


def _few(judgement: Judgement, causes: Causes) -> bool:
    """Whether too few mass points are all that is wrong."""
    return judgement.causes == (RESOLUTION,) and not causes


def _left_over(
    hypotheses: Hypotheses, causes: Causes, judgement: Judgement, data: _Data
) -> tuple[Missing | None, dict[str, object]]:
    """What is missing where that is unknown, and what is said of all that is left."""
    fit = hypotheses.tried[causes]
    found = missing(hypotheses, fit) if judgement.verdict == "unknown" else None
    differs = differing(hypotheses, causes) if found else None
    left = unexplained(hypotheses, fit, judgement.left, found, differs)
    said = ALONE if judgement.verdict == "insufficient" else str(left["sentence"])
    opened = OPENED.format(", ".join(data.shown)) if data.shown else ""
    return found, left | {"sentence": " ".join(filter(None, (opened, said)))}


def _written(
    hypotheses: Hypotheses, ground: Ground, causes: Causes, judgement: Judgement, data: _Data, proposal: Proposal
) -> Diagnosis:
    """The artifact."""
    found, left = _left_over(hypotheses, causes, judgement, data)
    gains = _gained(hypotheses, ground, causes, judgement, data) if len(data.observations) > 1 else HELD_OUT.empty()
    named = tables.causes(hypotheses, causes, judgement, data.library)
    base = ground.configured if _few(judgement, causes) else hypotheses.tried[frozenset()]
    text = document(hypotheses, ground, base, judgement, named, gains, data.rejected, left, proposal.next_experiment)
    settings = extended_settings(data.model, hypotheses, causes)
    said = " ".join(filter(None, (sentence(judgement, named), str(left["sentence"]))))
    row = {"verdict": judgement.verdict, "sentence": said, "diagnosis": json.dumps(without_nan(text), indent=2)}
    return Diagnosis(
        FINDING.check(pd.DataFrame([row | {"extended": yaml.safe_dump(settings, sort_keys=False)}])),
        named,
        gains,
        tables.residuals(hypotheses, causes),
        tables.theories(hypotheses, judgement),
        tables.screening(hypotheses),
        tables.likeness(hypotheses),
        MISSING.empty() if found is None else found.table,
        proposal.commands,
        proposal.control_points,
        proposal.foretold,
    )
