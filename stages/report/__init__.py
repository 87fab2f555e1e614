"""Report: one self-contained HTML page from everything a run has made."""

from stages.report.page import report
from stages.report.record import Cast, Record, cast_record

__all__ = ["Cast", "Record", "cast_record", "report"]
