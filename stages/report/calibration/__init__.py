"""The page of a calibration: what was measured of a camera, and by what."""

from stringcast.stages.report.calibration.page import calibration_report

__all__ = ["calibration_report"]
