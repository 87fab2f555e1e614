"""The page of a diagnosis: what the simulation gets wrong, why, and how much better it is once extended."""

from stringcast.stages.report.diagnosis.page import diagnosis_report
from stringcast.stages.report.diagnosis.record import DiagnosisRecord

__all__ = ["DiagnosisRecord", "diagnosis_report"]
