"""The trials by their use: searched, held out for the gain, or left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from stringcast.data.artifacts import Observation

CHAOTIC_REASON = "too sensitive to be simulated to the tolerance"


@dataclass(frozen=True)
class TrialsByUse:
    """Trials by their use.

    Attributes
    ----------
    observations : sequence of Observation
        All trials that can be used.
    held_out_names : sequence of str
        Names of trials in which only the gain is measured.
    rejected : dict
        Names of trials that cannot be used, with the reason.
    chaotic : sequence of str
        Names of trials that simulation does not resolve.
    outlying : dict
        Names of trials that the others do not predict, with the reason.
    predicted : sequence of str
        Names of trials that were outlying until causes predicted them.
    """

    observations: Sequence[Observation]
    held_out_names: Sequence[str]
    rejected: Mapping[str, str]
    chaotic: Sequence[str] = ()
    outlying: Mapping[str, str] = field(default_factory=dict)
    predicted: Sequence[str] = ()

    @property
    def left_out(self) -> dict[str, str]:
        """The reasons of trials that are not used, by name."""
        chaotic = dict.fromkeys(self.chaotic, CHAOTIC_REASON)
        return {**self.rejected, **chaotic, **self.outlying}

    @property
    def searched_trials(self) -> list[Observation]:
        """The trials in which causes are searched."""
        others = {*self.held_out_names, *self.left_out}
        return [o for o in self.observations if o.trial not in others]

    @property
    def held_out(self) -> list[Observation]:
        """The trials in which only the gain is measured."""
        return [o for o in self.observations if o.trial in self.held_out_names]

    def excluding_chaotic(self, names: Sequence[str]) -> TrialsByUse:
        """Exclude chaotic trials from the search."""
        return replace(self, chaotic=(*self.chaotic, *names))

    def including_predicted(self, names: Sequence[str]) -> TrialsByUse:
        """Include outlying trials in the search, since they are predicted."""
        outlying = {n: r for n, r in self.outlying.items() if n not in names}
        return replace(self, outlying=outlying, predicted=(*self.predicted, *names))
