"""The page of a calibration: what was measured of a camera, and by what."""

from stringcast.stages.report.calibration.page import calibration_report
from stringcast.stages.report.calibration.record import CalibrationRecord

__all__ = ["CalibrationRecord", "calibration_report"]
