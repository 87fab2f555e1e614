"""The page of an alignment."""

from stringcast.stages.report.alignment.page import AlignmentRecord, alignment_report

__all__ = ["AlignmentRecord", "alignment_report"]
