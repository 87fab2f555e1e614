"""The diagnosis: from trials and a model to a verdict with its evidence."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
import yaml
from pydantic import AfterValidator, Field
from scipy.stats import norm

from stringcast.data.artifacts import FINDING, HELD_OUT, Diagnosis, Observation, TrialSet
from stringcast.data.schema import DataError
from stringcast.stages.common import Enough, Progress
from stringcast.stages.diagnose import tables
from stringcast.stages.diagnose.budget import Budget, budgeted, one_after_another
from stringcast.stages.diagnose.casts import Design
from stringcast.stages.diagnose.design import Proposal, Rivals, designed
from stringcast.stages.diagnose.document import document, left_over, sentence, settings, without_nan
from stringcast.stages.diagnose.judgement import RESOLUTION, Judgement, interrupted, settled
from stringcast.stages.diagnose.predictions import better, held_out_table, predicted
from stringcast.stages.diagnose.prepared import Prepared, prepared, too_chaotic, usable
from stringcast.stages.diagnose.proposals import candidates
from stringcast.stages.diagnose.single_effects import Criteria, Found, removed, searched, unexplained
from stringcast.stages.diagnose.small_effects import tempered
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.estimate.trim import trimmed_at_contact
from stringcast.stages.inference.evidence import Fit, fitted
from stringcast.stages.inference.trial_data import Data
from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import Effect
from stringcast.stages.model.library import existing, library
from stringcast.stages.model.model import Model
from stringcast.stages.spec import Call

log = logging.getLogger(__name__)

WIDER = 1.4  # times the deviations of a likelihood: 95 % of 165 values of earlier benches then lie inside, 87 % without
DESIGN = 1  # keeps the chance of the design apart from that of the fits
CHAOTIC = "it is so sensitive that no simulation tells it to the tolerance; it was set aside"
ALONE = "Causes can be sought in one trial only: what is found in it could not be checked on another"
PLAIN = "# There is no extended model, for no effect is named. This is the base model.\n"


def run(call: Call, trials: TrialSet) -> Diagnosis:
    """The diagnosis of all trials until their string touches an obstacle, as a stage."""
    setup = call.setup
    seen = [trimmed_at_contact(trial, setup.obstacles) for trial in trials.observations]
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
    criteria: Criteria,
    matching: Matching,
    design: Design,
    without: Annotated[Sequence[str], AfterValidator(existing)] = (),
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """What the model gets wrong in these trials, and why.

    rejected: trials that cannot be used, with the reason. held_out: names of trials kept for measuring the gain; where
    there are none, each is left out in turn. starts: of the base model's search. matching: how E is counted. design: of
    the motion that would decide between look-alikes, clear of the obstacles. without: effects that are no candidates.
    Interrupted (`Enough`) after the base model, it ends with what it knows. Raises DataError without a trial to use.
    """
    asked, reached = _given(model, observations, rejected, held_out, criteria, matching), None
    try:
        for reached in _searched(asked, without, seed, starts, progress):
            given, ready, effects, found = reached
        found, judgement = settled(found, effects, criteria, _too_few_points(ready, criteria), seed)
        if given.rest and not judgement.causes and _shown(found, given.aside, criteria):
            log.info("the trials set aside show what the others do not: they are looked at as well")
            again = partial(diagnose, seed=seed, starts=starts, criteria=criteria, matching=matching, design=design)
            return again(model, asked.observations, asked.rejected, (), obstacles, without=without, progress=progress)
        gained = _gained(given, found, judgement.base)
        judgement = _checked(judgement, gained, len(given.kept), criteria)
        proposal = _proposal(found, judgement, criteria, obstacles, design, seed)
    except Enough:
        if reached is None:
            raise
        return _so_far(reached, seed)
    log.info("verdict: %s", judgement.verdict)
    return written(given, found, judgement, gained, proposal, seed)


@dataclass(frozen=True)
class Given:
    """What was given: trials, those rejected with the reason, numbers of those causes are sought in and of the rest."""

    model: Model
    observations: Sequence[Observation]
    rejected: Mapping[str, str]
    kept: Sequence[int]
    rest: Sequence[int]
    criteria: Criteria
    matching: Matching

    @property
    def asked(self) -> list[Observation]:
        """The trials in which causes are sought."""
        return [self.observations[i] for i in self.kept]

    @property
    def aside(self) -> list[Observation]:
        """The rest."""
        return [self.observations[i] for i in self.rest]

    @property
    def reach(self) -> float:
        """Half width of an interval, in standard deviations as the likelihood has them."""
        return WIDER * float(norm.ppf(0.5 + self.criteria.coverage / 2))

    def without(self, chaotic: Sequence[str]) -> Given:
        """Causes are not sought in these trials."""
        kept = [i for i in self.kept if self.observations[i].trial not in chaotic]
        return replace(self, kept=kept, rejected={**self.rejected, **dict.fromkeys(chaotic, CHAOTIC)})


class Reached(NamedTuple):
    """How far a search has come. ready: the base model, before any cause."""

    given: Given
    ready: Prepared
    effects: list[type[Effect]]
    found: Found


def _given(
    model: Model,
    observations: Sequence[Observation],
    rejected: Mapping[str, str],
    held_out: Sequence[str],
    criteria: Criteria,
    matching: Matching,
) -> Given:
    """The trials that can be used; all but those held out are asked, unless that is none. Raises DataError where none
    can be used."""
    good, faults = usable(model, observations)
    rejected = {**rejected, **faults}
    if not good:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in rejected.items())
        raise DataError(f"there is no trial that can be used ({reasons}). Look at the files it names.")
    rest = [i for i, o in enumerate(good) if o.trial in held_out]
    rest = rest if len(rest) < len(good) else []
    kept = [i for i in range(len(good)) if i not in rest]
    return Given(model, good, rejected, kept, rest, criteria, matching)


def _searched(given: Given, without: Sequence[str], seed: int, starts: int, progress: Progress) -> Iterator[Reached]:
    """Base model and candidates, without causes and with one after another. Trials that no simulation with the causes
    tells are set aside, as those that none without them does, unless it tells them with the causes; then the others, or
    they as well, are asked anew."""
    criteria, trusted = given.criteria, list[str]()
    while True:
        log.info("fitting the base model")
        rng = np.random.default_rng(seed)
        ready = prepared(
            given.model, given.asked, criteria.tolerance, rng, starts, lambda share: progress(0.3 * share), trusted
        )
        effects = candidates(ready.base.hypothesis.model, library(), ready.data.trials, without)
        good = given.without(ready.chaotic)
        yield Reached(good, ready, effects, Found(ready, ready.base))
        for number, found in enumerate(searched(ready, effects, criteria, seed, starts), 1):
            progress(0.3 + 0.5 * number / (criteria.causes + 1))
            if told := _told_with_causes(found, given):
                break
            yield Reached(good, ready, effects, found)
        if told:
            log.info("told with the causes found: %s", ", ".join(told))
            trusted += told
        elif chaotic := _chaotic(found, criteria):
            log.info("chaotic with the causes found: %s", ", ".join(chaotic))
            given = given.without((*ready.chaotic, *chaotic))
        else:
            return


def _so_far(reached: Reached, seed: int) -> Diagnosis:
    """The diagnosis of a search that was interrupted."""
    log.warning("interrupted: ending with what is known")
    judgement = interrupted(reached.found, reached.effects, reached.given.criteria, seed)
    nothing = Gained(HELD_OUT.empty(), False)
    return written(reached.given, reached.found, judgement, nothing, Proposal(), seed)


def _chaotic(found: Found, criteria: Criteria) -> list[str]:
    """Trials that are chaotic with the causes; those that are without any were set aside before."""
    return too_chaotic(found.prepared, criteria.tolerance) if found.fit.hypothesis.causes else []


def _told_with_causes(found: Found, given: Given) -> list[str]:
    """Trials that are chaotic without the causes, and are not with them: numerical error is large, too, where a string
    without them must be bent to what they do."""
    aside = [observation for observation in given.asked if observation.trial in found.prepared.chaotic]
    if not aside or not found.fit.hypothesis.causes:
        return []
    doubt = found.prepared.others(aside, found.fit)[1]
    return [o.trial for o, each in zip(aside, doubt, strict=True) if each < given.criteria.tolerance]


def _checked(judgement: Judgement, gained: Gained, trials: int, criteria: Criteria) -> Judgement:
    """As far as it can be checked: what is found in one trial not at all, in several by those left out. Where more is
    left than is tolerated, it must remove the least share of what is lacking in those, too."""
    if judgement.verdict in ("none", "insufficient") or judgement.causes == (RESOLUTION,):
        return judgement
    if trials == 1:
        likely = [f"{name} ({chance:.2f})" for name, chance in judgement.inclusion.items() if chance > 0.5]
        said = f"{ALONE}; there it is {', '.join(likely)}" if likely else ALONE
        return replace(judgement, verdict="insufficient", causes=(), groups=(), sentence=f"{said}.")
    enough = judgement.unknown <= 0.5 or gained.removed(criteria.tolerance) >= criteria.least_share
    return judgement if gained.better and enough else judgement.unsupported


def _too_few_points(ready: Prepared, criteria: Criteria) -> bool:
    """Whether the configured mesh is worse than one that does not matter, and has the tip farther away than is
    tolerated."""
    own = ready.configured
    if own is None or ready.base.evidence - own.evidence < criteria.enough:
        return False
    apart = [each - base for each, base in zip(own.residuals, ready.base.residuals, strict=True)]
    return bool(ready.data.tip_rms(apart).max() > criteria.tolerance)


def _shown(found: Found, observations: Sequence[Observation], criteria: Criteria) -> bool:
    """Whether trials that were set aside lack more at the tip than is tolerated, the model fitted to them as well: what
    the others leave open of its parameters is no cause."""
    seen, aside = found.prepared.data, found.prepared.others(observations, found.fit)[0]
    varying = {name: seen.varying[name] + aside.varying[name] for name in seen.varying.keys() & aside.varying.keys()}
    data = Data(seen.trials + aside.trials, varying)
    sizes = np.concatenate([found.fit.sizes, np.zeros(len(aside.trials), dtype=int)])
    fit = fitted(data, found.fit.hypothesis, found.fit.chi[None], sizes)
    return bool(unexplained(data, fit)[len(seen.trials) :].max() > criteria.tolerance)


def _proposal(
    found: Found, judgement: Judgement, criteria: Criteria, obstacles: Sequence[Box], design: Design, seed: int
) -> Proposal:
    """The motion that would tell the first group of look-alikes apart."""
    group = judgement.groups[0] if judgement.groups else ()
    fits = {name: tables.fit_with(found, judgement, name) for name in group if name != RESOLUTION}
    odds = float(np.log(criteria.coverage / (1 - criteria.coverage)))
    return designed(Rivals(fits, found.prepared.data, odds), obstacles, design, np.random.default_rng([seed, DESIGN]))


@dataclass(frozen=True)
class Gained:
    """held_out: table HELD_OUT. better: whether the extended model predicts trials left out better than the base."""

    held_out: pd.DataFrame
    better: bool

    def removed(self, tolerance: float) -> float:
        """Share of what the base model lacks at the tips of trials left out that the extended model does not."""
        before, after = (self.held_out[f"tip_rms_{side}"].to_numpy() for side in ("base", "extended"))
        return removed(before, after, tolerance)


def written(
    given: Given, found: Found, judgement: Judgement, gained: Gained, proposal: Proposal, seed: int
) -> Diagnosis:
    """The artifact: of the base model alone, beside all hypotheses, where none of the causes found is named."""
    data, named = found.prepared.data, set(judgement.causes) & set(found.fit.hypothesis.names)
    shown = found if named else replace(found, fit=judgement.base)
    budget = budgeted(shown, judgement.base, np.random.default_rng([seed, len(data.trials)]))
    causes = tables.causes(shown, judgement, given.reach)
    return Diagnosis(
        _finding(given, shown, judgement, gained, proposal, budget, causes),
        causes,
        gained.held_out,
        tables.residuals(found.prepared, judgement.base, shown.fit),
        tables.theories(found, budget.by_cause, judgement, given.criteria.tolerance),
        tables.entries(data, budget.by_cause if named else one_after_another(found, judgement.base)),
        tables.screening(found),
        tables.likeness(found),
        tables.missing(data, shown.fit, given.criteria),
        proposal.commands,
        proposal.control_points,
        proposal.foretold,
    )


def _finding(
    given: Given,
    found: Found,
    judgement: Judgement,
    gained: Gained,
    proposal: Proposal,
    budget: Budget,
    named: pd.DataFrame,
) -> pd.DataFrame:
    """Table FINDING. named: table CAUSES."""
    data, base, z = found.prepared.data, judgement.base, given.reach
    left = left_over(data, found.fit, base, judgement, budget, given.criteria)
    plain = tempered(data, base, judgement.small)
    more = tempered(data, found.fit, judgement.small)
    sure = {"base": tables.certainty(base, plain, z), "extended": tables.certainty(found.fit, more, z)}
    evidence = (budget, named, gained.held_out, given.rejected, left, proposal.next_experiment, sure)
    text = document(found.prepared, base, judgement, *evidence)
    said = " ".join(filter(None, (sentence(judgement, named), str(left["sentence"]))))
    row = {"verdict": judgement.verdict, "sentence": said, "diagnosis": json.dumps(without_nan(text), indent=2)}
    row |= {"extended": _extended(given, found.fit, sure["extended"]["intervals"])}
    return FINDING.check(pd.DataFrame([row]))


def _gained(given: Given, found: Found, base: Fit) -> Gained:
    """What the causes gain on trials left out: nothing where there is one trial."""
    if len(given.observations) == 1:
        return Gained(HELD_OUT.empty(), False)
    seen = given.aside or given.asked
    data = found.prepared.others(seen, found.fit)[0] if given.rest else found.prepared.data
    more = predicted(data, found.fit, unseen=True) if given.rest else found.predictions
    plain = more if base is found.fit else predicted(data, base, unseen=bool(given.rest))
    return Gained(held_out_table(data, plain, more, found.fit, seen, given.matching), better(plain, more))


def _extended(given: Given, fit: Fit, ends: Mapping[str, Sequence[float]]) -> str:
    """extended.yaml: the model with its causes, else the base model, which it says. ends: of the intervals of all
    parameters."""
    own = [cause.qualified(p) for cause in fit.hypothesis.causes for p in cause.parameters]
    text = yaml.safe_dump(settings(given.model, fit, {name: ends[name] for name in own}), sort_keys=False)
    return text if own else PLAIN + text
