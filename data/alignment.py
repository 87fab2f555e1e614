"""The artifact of `align`: the camera's pose and clock relative to the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from stringcast.data.schema import Table, parse_columns, tables_by_name

MEASURED_PARAMETERS = Table(
    "measured",
    "the measured parameters; effects that were tried and not seen have found = false",
    parse_columns("""
    name (text): qualified name of the parameter
    unit (text): its unit
    meaning (text): what it is
    value: best value, in `unit`
    low: lower end of the 95 % interval, in `unit`
    high: upper end of the 95 % interval, in `unit`
    found (bool): it is part of the alignment
    """),
)
SIGHTINGS = Table(
    "seen",
    "every sighting of the arm; it is measured along one direction only",
    parse_columns("""
    trial (text): name of the trial
    t [s]: time by the camera's clock
    link [1] (int): link of the arm, 1 is at the base
    share [1]: how far along the link
    x [m]: where it was seen
    y [m]: where it was seen
    along_x [1]: direction in which it was measured
    along_y [1]: direction in which it was measured
    sigma [m]: one standard deviation
    before [m]: reported less seen, as if camera and arm were aligned
    after [m]: reported less seen, aligned
    """),
)
LIKELIHOOD = Table(
    "likelihood",
    "how much worse the fit is with a given time offset; 3.84 is the end of a 95 % "
    "interval",
    parse_columns("""
    offset [s]: arm's clock less the camera's
    alone [1]: rise of the deviance without a lag of the arm, corrected for correlated
        noise
    with_lag [1]: the same where the arm may lag as well
    lag [s]: the lag that then fits best
    """),
)
ALIGNMENT_SUMMARY = Table(
    "aligned",
    "one row: how it went",
    parse_columns("""
    sentence (text): in words
    rms_before [m]: residual as if camera and arm were aligned
    rms_after [m]: residual aligned
    noise [m]: what noise alone would leave
    speed [m/s]: fastest that a sighted point moved
    most_lag [s]: a lag of the arm up to this cannot be told from the offset; 0 where
        one was measured
    extended (text): the model with the alignment as settings, YAML
    """),
)


@dataclass(frozen=True)
class Alignment:
    """Pose and clock of the camera relative to the arm, made by `align`."""

    measured: pd.DataFrame
    seen: pd.DataFrame
    likelihood: pd.DataFrame
    aligned: pd.DataFrame

    TABLES: ClassVar = tables_by_name(
        MEASURED_PARAMETERS,
        SIGHTINGS,
        LIKELIHOOD,
        ALIGNMENT_SUMMARY,
    )

    @property
    def sentence(self) -> str:
        """The outcome in a sentence."""
        return str(self.aligned["sentence"].iloc[0])

    @property
    def extended_yaml(self) -> str:
        """Model settings with this alignment, for other experiments (YAML)."""
        return str(self.aligned["extended"].iloc[0])
