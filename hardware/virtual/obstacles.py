"""Obstacles of the lab: boxes off which the string bounces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from stringcast.stages.model.box import Box
from stringcast.stages.model.effect import numbered_effect
from stringcast.stages.model.effects.box_contact import BoxContact

NonNegativeNumber = Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class Obstacles:
    """Boxes that stand in the lab, and what they are made of.

    stiffness: push over the string's mass per depth [1/s^2]; at 4e6 a point at 6 m/s
    goes 3 mm deep. friction: its coefficient. loss: share of the push lost per speed of
    impact [s/m].
    """

    boxes: tuple[Box, ...] = ()
    stiffness: NonNegativeNumber = 4.0e6
    friction: NonNegativeNumber = 0.3
    loss: NonNegativeNumber = 0.1

    @property
    def effects(self) -> tuple[type[BoxContact], ...]:
        """One for each box."""
        return tuple(
            numbered_effect(BoxContact, number) for number in range(len(self.boxes))
        )

    @property
    def parameter_values(self) -> dict[str, float]:
        """The effects' parameters, by qualified name."""
        alike = {
            "stiffness": self.stiffness,
            "friction": self.friction,
            "loss": self.loss,
        }
        return {
            f"{effect.name}.{name}": size
            for effect, box in zip(self.effects, self.boxes, strict=True)
            for name, size in {
                "centre_x": box.x,
                "centre_y": box.y,
                "width": box.w,
                "height": box.h,
                **alike,
            }.items()
        }
