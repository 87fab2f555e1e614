"""Obstacles of the lab: boxes that the string can hit."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import NonNegativeFloat

from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import numbered_effect
from stringcast.stages.model.effects.box_contact import BoxContact


@dataclass(frozen=True)
class Obstacles:
    """Boxes in the lab and their material.

    Attributes
    ----------
    boxes
        The boxes.
    stiffness
        Contact force over the string's mass per depth [1/s^2]; at 4e6 a point at 6 m/s
        penetrates 3 mm.
    friction
        Coefficient of friction.
    loss
        Relative loss of contact force per impact speed [s/m].
    """

    boxes: tuple[Box, ...] = ()
    stiffness: NonNegativeFloat = 4.0e6
    friction: NonNegativeFloat = 0.3
    loss: NonNegativeFloat = 0.1

    @property
    def effects(self) -> tuple[type[BoxContact], ...]:
        """The contact effects of the boxes, one for each box."""
        numbers = range(len(self.boxes))
        return tuple(numbered_effect(BoxContact, number) for number in numbers)

    @property
    def parameter_values(self) -> dict[str, float]:
        """Parameters of the effects by qualified name."""
        values: dict[str, float] = {}
        for effect, box in zip(self.effects, self.boxes, strict=True):
            contact = {
                "centre_x": box.x,
                "centre_y": box.y,
                "width": box.w,
                "height": box.h,
                "stiffness": self.stiffness,
                "friction": self.friction,
                "loss": self.loss,
            }
            values |= {f"{effect.name}.{key}": value for key, value in contact.items()}
        return values
