"""The page of an alignment."""

from stringcast.stages.report.alignment.page import alignment_report

__all__ = ["alignment_report"]
