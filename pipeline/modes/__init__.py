"""Loops over stages, chosen by the setting `mode`."""

from stringcast.pipeline.modes.batch import Batch
from stringcast.pipeline.modes.calibrate import Calibrate
from stringcast.pipeline.modes.cast import Cast
from stringcast.pipeline.modes.diagnose import Diagnose
from stringcast.pipeline.modes.estimate import EstimateTrials

__all__ = ["Batch", "Calibrate", "Cast", "Diagnose", "EstimateTrials"]
