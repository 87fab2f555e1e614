"""Report: one self-contained HTML page from everything a run has made."""

from stringcast.stages.report.page import report
from stringcast.stages.report.record import Cast, Record, cast_record

__all__ = ["Cast", "Record", "cast_record", "report"]
