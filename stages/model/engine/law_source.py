"""The laws of effects as text of the step loop."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.law_slots import FREE_LENGTH_ROWS, law_arguments

# Expressions of a law's arguments in the loop, by slot. In a free string longer than
# stated, arc lengths are scaled by the ratio.
ARGUMENT_EXPRESSIONS: dict[str, dict[str, str]] = {
    "tension": {"stretch": "stretch", "rate": "rate", "s": "s_middle{ratio}"},
    "moment": {"curvature": "curvature", "rate": "bend", "s": "s_hinge{ratio}"},
    "hinge_memory": {"change": "change", "dt": "duration"},
    "hinge_memory_moment": {},
    "grasp_memory": {"change": "change", "dt": "duration"},
    "grasp_memory_moment": {},
    "hinge_stiffness": {},
    "grasp_moment": {"angle": "curvature", "rate": "bend"},
    "load": {
        "x": "px",
        "y": "py",
        "vx": "qx",
        "vy": "qy",
        "ux": "(qx - airx)",
        "uy": "(qy - airy)",
        "tx": "lx",
        "ty": "ly",
        "s": "s_point{ratio}",
        "t": "t",
        "dt": "dt",
    },
    "acceleration": {"x": "px", "y": "py", "t": "t"},
    "flow": {"x": "px", "y": "py", "t": "t"},
    "rest_curvature": {
        "s": "s_hinge{ratio}",
        "length": "string_length{ratio}",
    },
}
MASS_SLOTS = {"density", "tip_mass", "tip_length"}


@dataclass(frozen=True)
class LawSource:
    """Text of the laws of some effects in the loop.

    Parameters
    ----------
    effects : sequence of StringEffect classes
        The effects in the loop.
    row_names : sequence of str
        Names of the rows of parameters, as `String.row_names`.
    """

    effects: Sequence[type[StringEffect]]
    row_names: Sequence[str]

    def effects_with(self, slot: str) -> list[type[StringEffect]]:
        """Return the effects that have a law in a slot."""
        return [effect for effect in self.effects if slot in effect.laws()]

    @property
    def masses_vary(self) -> bool:
        """Whether a point's mass may differ from that of its length of string."""
        return any(MASS_SLOTS & effect.laws().keys() for effect in self.effects)

    @property
    def per_segment(self) -> str:
        """Row of the inverse rest length of a segment, if candidates differ in it."""
        return self._row_if_any(FREE_LENGTH_ROWS[1])

    def definitions(self) -> list[str]:
        """Return the source of all laws, as functions named after effect and slot."""
        texts = []
        for slot in ARGUMENT_EXPRESSIONS:
            for effect in self.effects_with(slot):
                source = textwrap.dedent(inspect.getsource(effect.laws()[slot]))
                body = source[source.index("def ") :].rstrip("\n")
                name = f"def {effect.name}_{slot}("
                texts.append(body.replace(f"def {slot}(", name, 1))
        return texts

    def sum_of_laws(self, slot: str, **arguments: str) -> str:
        """Return an expression of the sum of all laws of a slot."""
        calls = [
            self.call(effect, slot, **arguments) for effect in self.effects_with(slot)
        ]
        return " + ".join(calls) or "0.0"

    def call(self, effect: type[StringEffect], slot: str, **arguments: str) -> str:
        """Return a call of a law with its arguments.

        Arguments of the slot are passed by name; `arguments` are additional ones. All
        others are parameters; the effect's own take precedence over the paper's. Raises
        TypeError if the law takes any other argument.
        """
        known = {**ARGUMENT_EXPRESSIONS[slot], **arguments}
        ratio = self._row_if_any(FREE_LENGTH_ROWS[0])
        factor = f" * {ratio}" if ratio else ""
        texts = []
        for name in law_arguments(effect.laws()[slot]):
            own_name = f"{effect.name}.{name}"
            if name in known:
                texts.append(known[name].replace("{ratio}", factor))
            elif own_name in self.row_names:
                texts.append(self.parameter(own_name))
            elif name in self.row_names:
                texts.append(self.parameter(name))
            else:
                names = ", ".join(self.row_names)
                raise TypeError(
                    f"effect '{effect.name}': no parameter '{name}'; there are {names}"
                )
        return f"{effect.name}_{slot}({', '.join(texts)})"

    def parameter(self, name: str) -> str:
        """Return an expression of a parameter of the lane's candidate."""
        return f"values[np.uintp({list(self.row_names).index(name)}) * LANES + lane]"

    def _row_if_any(self, name: str) -> str:
        return self.parameter(name) if name in self.row_names else ""
