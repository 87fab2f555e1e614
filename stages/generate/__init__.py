"""Generate: random joint-velocity curves until the simulated tip hits the target (III)."""

from stages.generate.generate import MotionNotFoundError, generate
from stages.generate.space import check_reach
from stages.model.box import Box

__all__ = ["Box", "MotionNotFoundError", "check_reach", "generate"]
