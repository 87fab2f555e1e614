"""Align: rotation, origin and scale of the camera in the arm's frame, and the offset of their clocks, as measured."""

from stringcast.stages.align.align import align

__all__ = ["align"]
