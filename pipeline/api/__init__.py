"""Cast an unknown string with a robot arm, and find out why the simulation is off.

    import stringcast as sc

    trials = sc.read("my-folder")    # or sc.sample(), or sc.trials(points, ...)
    result = sc.diagnose(trials)     # result.sentence, .causes, .gain, .plot()
    motion = sc.generate(result.extended_model, target=(0.4, 0.7))
    string = sc.simulate(result.extended_model, motion)

Settings are given as on the command line: `sc.diagnose(trials, "string.points=15")`.
Lengths are in metres, times in seconds, angles in radians. Input that cannot be used
raises `sc.StringcastError`, whose message names the remedy.

The parts of the package are `stringcast.data`, `.stages`, `.hardware` and `.pipeline`;
each is a folder of a clone.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from stringcast.data.errors import ExpectedError as StringcastError

if TYPE_CHECKING:
    from stringcast.answers import DiagnosisResult, EstimateResult, diagnose, estimate
    from stringcast.casting import cast, generate, simulate
    from stringcast.known import KnownString
    from stringcast.measured import Trials, read, sample, trials

__version__ = version("stringcast")
__all__ = [
    "DiagnosisResult",
    "EstimateResult",
    "KnownString",
    "StringcastError",
    "Trials",
    "cast",
    "diagnose",
    "estimate",
    "generate",
    "read",
    "sample",
    "simulate",
    "trials",
]
MODULES_OF_NAMES = {
    "answers": ("DiagnosisResult", "EstimateResult", "diagnose", "estimate"),
    "casting": ("cast", "generate", "simulate"),
    "known": ("KnownString",),
    "measured": ("Trials", "read", "sample", "trials"),
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, as imports take seconds."""
    for module, names in MODULES_OF_NAMES.items():
        if name in names:
            return getattr(import_module(f"stringcast.{module}"), name)
    public_names = ", ".join(__all__)
    raise AttributeError(
        f"module 'stringcast' has no attribute '{name}'. There are {public_names}."
    )


def __dir__() -> list[str]:
    """List the public names of the package."""
    return [*__all__, "__version__"]
