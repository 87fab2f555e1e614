"""stringcast: cast an unknown string with a robot arm, and find out why the simulation
disagrees with the camera.

    import stringcast as sc

    trials = sc.read("my-folder")                 # or sc.sample(), or sc.trials(points, grasp=poses, length=0.3)
    result = sc.diagnose(trials)                  # result.sentence, .causes, .gain, .plot(), .report("page.html")
    motion = sc.generate(result.extended, target=(0.4, 0.7))
    string = sc.simulate(result.extended, motion)

Settings of the pipeline go along as words, as on its command line: `sc.diagnose(trials,
"string.points=15")`. Lengths are in metres, times in seconds, angles in radians. What
cannot be used raises `sc.StringcastError`, with the remedy.

The rooms are `stringcast.data`, `.stages`, `.hardware` and `.pipeline`; a clone has a
folder for each.
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
HOMES = {
    "answers": ("DiagnosisResult", "EstimateResult", "diagnose", "estimate"),
    "casting": ("cast", "generate", "simulate"),
    "known": ("KnownString",),
    "measured": ("Trials", "read", "sample", "trials"),
}


def __getattr__(name: str) -> Any:
    """Load what is asked for when it is: the command line needs none of it, and it
    takes seconds.
    """
    for module, names in HOMES.items():
        if name in names:
            return getattr(import_module(f"stringcast.{module}"), name)
    raise AttributeError(
        f"module 'stringcast' has no attribute '{name}'. There are {', '.join(__all__)}."
    )


def __dir__() -> list[str]:
    """The names that the package offers."""
    return [*__all__, "__version__"]
