"""Which benches a seed means: names, frozen, so that a cause that is added moves no
bench that was drawn.

A version is never changed; what is new goes into a new one, the last of its
laboratory's in VERSIONS.
"""

from __future__ import annotations

from dataclasses import dataclass

NONE, SINGLE, PAIR, TRIPLE, OUTSIDE = "none", "single", "pair", "triple", "outside"


TURNS = (SINGLE, NONE, OUTSIDE, PAIR, SINGLE, OUTSIDE, NONE, SINGLE, TRIPLE, SINGLE)


@dataclass(frozen=True)
class Version:
    """Names of the causes that a bench may hide, in order. together: those that may be
    one of a pair or a triple.
    """

    single: tuple[str, ...]
    together: tuple[str, ...]
    outside: tuple[str, ...]

    def kind(self, seed: int) -> str:
        """The kind of bench that a seed means; any ten in a row are balanced."""
        return TURNS[seed % len(TURNS)]

    def turn(self, seed: int, kind: str) -> int:
        """The number of benches of a kind before that of a seed; the seed itself if it
        has another kind.
        """
        if kind != self.kind(seed):
            return seed
        return seed // len(TURNS) * TURNS.count(kind) + TURNS[
            : seed % len(TURNS)
        ].count(kind)


_STRING = (
    "tip_mass",
    "taper",
    "set",
    "hardening",
    "rub",
    "relaxing",
    "across",
    "wind",
    "gravity",
    "plane",
)
_AROUND = (
    "lag",
    "gain",
    "play",
    "angle",
    "slip",
    "offset",
    "drift",
    "roll",
    "scale",
    "lens",
    "readout",
)
FIRST = Version(
    single=_STRING + _AROUND,
    together=tuple(name for name in _STRING + _AROUND if name != "relaxing"),
    outside=(
        *(
            "stiffness_taper",
            "soft_spot",
            "bead",
            "flag",
            "crisis",
            "flutter",
            "letting_go",
            "pull",
            "eddy",
            "peg",
        ),
        *(
            "thread",
            "gust",
            "blow",
            "hold",
            "stick",
            "askew_joint",
            "ringing",
            "link",
            "shaken_base",
            "jump",
            "bump",
        ),
        *("shaken_camera", "askew_camera", "stretch", "misread"),
    ),
)
NO_MEMORY = Version(  # PyElastica's moment is linear in the turn
    single=tuple(
        name for name in FIRST.single if name not in ("hardening", "rub", "relaxing")
    ),
    together=tuple(name for name in FIRST.together if name not in ("hardening", "rub")),
    outside=FIRST.outside,
)
# of 1 some hid what acted in no trial that was kept; of 2 a string wound about its
# grasp was held the other way
VERSIONS = {"nodal": {3: FIRST}, "pyelastica": {3: NO_MEMORY}}
