"""The extraction study: casts rendered under every condition, read, and compared with what was really so."""

from stringcast.pipeline.studies.extraction.films import Cell, Take, read, take
from stringcast.pipeline.studies.extraction.scores import compared, shares

__all__ = ["Cell", "Take", "compared", "read", "shares", "take"]
