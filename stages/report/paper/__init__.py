"""The page of the paper's experiments: its tables and figures with ours beside them."""

from stringcast.stages.report.paper.figures import figures
from stringcast.stages.report.paper.page import paper_report
from stringcast.stages.report.paper.record import PaperRecord

__all__ = ["PaperRecord", "figures", "paper_report"]
