"""The page of a sweep: how what came out responds to what was varied."""

from stringcast.stages.report.sweep.page import sweep_report
from stringcast.stages.report.sweep.record import SweepRecord

__all__ = ["SweepRecord", "sweep_report"]
