"""Artifacts of surprises in the loop, and of their explanation by causes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import ClassVar

import pandas as pd

from stringcast.data.estimates import Estimate
from stringcast.data.schema import Table, parse_columns, tables_by_name

SURPRISE_SUMMARY = Table(
    "surprise",
    "one row: whether the trial is within what was predicted",
    parse_columns("""
    draws [1] (int): predictions that the trial is compared with
    frames [1] (int): frames in which the tip is compared
    distance [1]: of the tip from the predictions, over their spread; NaN without any
    p_value [1]: share of predictions that lie as far from the others; NaN without any
    surprising (bool): the trial is not within what was predicted
    sentence (text): the same in words
    """),
)


@dataclass(frozen=True)
class Surprise:
    """Test whether a trial agrees with its prediction."""

    surprise: pd.DataFrame

    TABLES: ClassVar = tables_by_name(SURPRISE_SUMMARY)

    @property
    def is_surprising(self) -> bool:
        """Whether the trial disagrees with its prediction."""
        return bool(self.surprise["surprising"].iloc[0])

    @property
    def p_value(self) -> float:
        """Predictive p-value of the trial; NaN without predictions."""
        return float(self.surprise["p_value"].iloc[0])

    @property
    def sentence(self) -> str:
        """The result in words."""
        return str(self.surprise["sentence"].iloc[0])


MIN_SHOWN_PROBABILITY = 0.01  # smallest probability in run.json and on pages
# verdicts whose causes leave much of the misfit unexplained
PARTLY_EXPLAINED = ("partial", "undecided", "unknown")
EXPLANATIONS = Table(
    "explanations",
    "causes that were compared, the most probable first; none has an empty name",
    parse_columns("""
    effects (text): names, separated by spaces; empty for the model as it was
    probability [1]: that these alone are active; the rest belongs to untried causes
    log_evidence [1]: gain over the model as it was
    tip_rms [m]: distance of the simulated from the measured tip, root mean square
    fitted (bool): fitted from many starts; else compared by a few iterations
    """),
)
EXPLANATION_SUMMARY = Table(
    "finding",
    "one row: the cause of a surprising trial",
    parse_columns("""
    verdict (text): not asked, none, cause, candidates, partial, unknown or undecided
    candidates [1] (int): causes that could act in these trials
    fitted [1] (int): causes that were fitted
    sentence (text): the verdict in words
    rms_without [m] (optional): centre-line residual of the model without causes
    screened (text, optional): sets of causes to which all effects were added, in these
        or earlier trials; names are separated by spaces, and each set ends with ;
    """),
)


def describe_bases(bases: Collection[tuple[str, ...]]) -> str:
    """Describe sets of causes, as the column `screened`."""
    return "".join(" ".join(base) + ";" for base in sorted(bases))


@dataclass(frozen=True)
class Explanation(Estimate):
    """An estimate with the causes that explain surprising trials.

    Its draws come from all probable sets of causes, weighted by probability.
    """

    explanations: pd.DataFrame = field(default_factory=EXPLANATIONS.empty)
    finding: pd.DataFrame = field(default_factory=EXPLANATION_SUMMARY.empty)

    TABLES: ClassVar = {
        **Estimate.TABLES,
        **tables_by_name(EXPLANATIONS, EXPLANATION_SUMMARY),
    }

    @property
    def verdict(self) -> str:
        """The verdict in a word or two."""
        return str(self.finding["verdict"].iloc[0])

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return str(self.finding["sentence"].iloc[0])

    @property
    def model_error_m(self) -> float:
        """Error of the model for motions unlike the trials [m].

        Causes that leave much unexplained may imitate another cause and fit these
        trials only. The error of the model without them is then used.
        """
        left_m = super().model_error_m
        if self.verdict not in PARTLY_EXPLAINED:
            return left_m
        return max(left_m, float(self.finding["rms_without"].iloc[0]))

    @property
    def named_causes(self) -> tuple[str, ...]:
        """Effects that explain the trials; empty without a verdict."""
        return next(iter(self.cause_sets)) if self.verdict == "cause" else ()

    @property
    def untried_probability(self) -> float:
        """Probability of causes that there was no time to compare."""
        if self.explanations.empty:
            return 0.0
        return 1 - sum(self.cause_sets.values())

    @property
    def screened_bases(self) -> list[tuple[str, ...]]:
        """Sets of causes to which all effects were added, also in earlier trials."""
        if "screened" not in self.finding:
            return []
        *bases, _ = str(self.finding["screened"].iloc[0]).split(";")
        return [tuple(base.split()) for base in bases]

    @property
    def causes(self) -> dict[str, float]:
        """Probability of each compared effect, alone or with others."""
        causes: dict[str, float] = {}
        for names, probability in self.cause_sets.items():
            for name in names:
                causes[name] = causes.get(name, 0.0) + probability
        return causes

    @property
    def cause_sets(self) -> dict[tuple[str, ...], float]:
        """Probability of each compared set of effects, by their names."""
        table = self.explanations
        pairs = zip(table["effects"], table["probability"], strict=True)
        return {tuple(str(names).split()): float(p) for names, p in pairs}
