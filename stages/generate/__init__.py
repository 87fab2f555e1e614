"""Generate: random joint-velocity curves until the simulated tip hits the target (III)."""

from stringcast.stages.generate.generate import MotionNotFoundError, generate
from stringcast.stages.generate.space import check_reach
from stringcast.stages.model.box import Box

__all__ = ["Box", "MotionNotFoundError", "check_reach", "generate"]
