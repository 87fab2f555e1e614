"""The model and the settings of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import ndtri

from stringcast.stages.common import Progress
from stringcast.stages.diagnose.proposal.candidate_motions import DesignSettings
from stringcast.stages.diagnose.rules import Criteria
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.model.box import Box
from stringcast.stages.model.model import Model

# Factor on the intervals of the likelihood. With it they contain 95 % of 165 true
# values of earlier synthetic datasets, without it 87 %
INTERVAL_WIDENING = 1.4


@dataclass(frozen=True)
class DiagnosisSettings:
    """The model and the settings of a diagnosis (see `diagnose`).

    mesh_may_be_coarser: whether a coarse mesh is used where it is accurate.
    """

    model: Model
    obstacles: Sequence[Box]
    seed: int
    starts: int
    criteria: Criteria
    matching: Matching
    design: DesignSettings
    excluded_effects: Sequence[str]
    progress: Progress
    mesh_may_be_coarser: bool = True

    @property
    def interval_half_width(self) -> float:
        """Half width of an interval in standard deviations of the likelihood."""
        normal = float(ndtri(0.5 + self.criteria.coverage / 2))
        return INTERVAL_WIDENING * normal
