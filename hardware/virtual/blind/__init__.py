"""Benches that hide a cause, for tests of the diagnosis: measured points and joint logs, and a sealed envelope."""

from stringcast.hardware.virtual.blind.bench import BlindBench
from stringcast.hardware.virtual.blind.drawing import draw
from stringcast.hardware.virtual.blind.version import LATEST, VERSIONS

__all__ = ["LATEST", "VERSIONS", "BlindBench", "draw"]
