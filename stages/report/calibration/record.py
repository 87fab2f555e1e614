"""What the page of a calibration is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stringcast.data.calibration import Calibration


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration and how it ended, in a sentence."""

    name: str
    sentence: str
    made: Calibration = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False)
    origin: Mapping[str, Any] = field(repr=False)
