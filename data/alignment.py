"""The artifact of `align`: the camera's pose and clock relative to the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from stringcast.data.schema import Column, Table

MEASURED_PARAMETERS = Table(
    "measured",
    "the measured parameters; effects that were tried and not seen have found = false",
    (
        Column("name", "", "qualified name of the parameter", "text"),
        Column("unit", "", "its unit", "text"),
        Column("meaning", "", "what it is", "text"),
        Column("value", "", "best value, in `unit`"),
        Column("low", "", "lower end of the 95 % interval, in `unit`"),
        Column("high", "", "upper end of the 95 % interval, in `unit`"),
        Column("found", "", "it is part of the alignment", "bool"),
    ),
)
SIGHTINGS = Table(
    "seen",
    "every sighting of the arm; it is measured along one direction only",
    (
        Column("trial", "", "name of the trial", "text"),
        Column("t", "s", "time by the camera's clock"),
        Column("link", "1", "link of the arm, 1 is at the base", "int"),
        Column("share", "1", "how far along the link"),
        Column("x", "m", "where it was seen"),
        Column("y", "m", "where it was seen"),
        Column("along_x", "1", "direction in which it was measured"),
        Column("along_y", "1", "direction in which it was measured"),
        Column("sigma", "m", "one standard deviation"),
        Column("before", "m", "reported less seen, as if camera and arm were aligned"),
        Column("after", "m", "reported less seen, aligned"),
    ),
)
LIKELIHOOD = Table(
    "likelihood",
    "how much worse the fit is with a given time offset; 3.84 is the end of a 95 % interval",
    (
        Column("offset", "s", "arm's clock less the camera's"),
        Column(
            "alone",
            "1",
            "rise of the deviance without a lag of the arm, corrected for correlated noise",
        ),
        Column("with_lag", "1", "the same where the arm may lag as well"),
        Column("lag", "s", "the lag that then fits best"),
    ),
)
ALIGNMENT_SUMMARY = Table(
    "aligned",
    "one row: how it went",
    (
        Column("sentence", "", "in words", "text"),
        Column("rms_before", "m", "residual as if camera and arm were aligned"),
        Column("rms_after", "m", "residual aligned"),
        Column("noise", "m", "what noise alone would leave"),
        Column("speed", "m/s", "fastest that a sighted point moved"),
        Column(
            "most_lag",
            "s",
            "a lag of the arm up to this cannot be told from the offset; 0 where one was measured",
        ),
        Column(
            "extended", "", "the model with the alignment as settings, YAML", "text"
        ),
    ),
)


@dataclass(frozen=True)
class Alignment:
    """Pose and clock of the camera relative to the arm's: the artifact of `align`."""

    measured: pd.DataFrame
    seen: pd.DataFrame
    likelihood: pd.DataFrame
    aligned: pd.DataFrame

    TABLES: ClassVar[dict[str, Table]] = {
        "measured": MEASURED_PARAMETERS,
        "seen": SIGHTINGS,
        "likelihood": LIKELIHOOD,
        "aligned": ALIGNMENT_SUMMARY,
    }

    @property
    def sentence(self) -> str:
        """The outcome in a sentence."""
        return str(self.aligned["sentence"].iloc[0])

    @property
    def extended_yaml(self) -> str:
        """Settings of the model with the alignment, for other experiments (YAML)."""
        return str(self.aligned["extended"].iloc[0])

    def aligned_values(self) -> dict[str, float]:
        """Return the values that are part of the alignment, by qualified name."""
        rows = self.measured[self.measured["found"]]
        return dict(zip(rows["name"], rows["value"], strict=True))
