"""Benches that hide a cause, for tests of the diagnosis: measured points and joint logs, and a sealed envelope."""

from hardware.virtual.blind.bench import BlindBench
from hardware.virtual.blind.drawing import CASES, draw

__all__ = ["CASES", "BlindBench", "draw"]
