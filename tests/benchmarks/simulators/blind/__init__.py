"""Benches that hide a cause, for tests of the diagnosis: measured points and joint
logs, and a sealed envelope.
"""

from tests.benchmarks.simulators.blind.bench import BlindBench
from tests.benchmarks.simulators.blind.drawing import draw
from tests.benchmarks.simulators.blind.version import LATEST, VERSIONS

__all__ = ["LATEST", "VERSIONS", "BlindBench", "draw"]
