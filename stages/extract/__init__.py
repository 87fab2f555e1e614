"""Extract: from camera frames to the string's centre-line, tip and binary images (IV-B)."""

from stringcast.stages.extract.extract import extract
from stringcast.stages.extract.footage import Footage, aligned_footage, footage_of

__all__ = ["Footage", "aligned_footage", "extract", "footage_of"]
