"""An obstacle that the string touches: a box with sides along x and y."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
    is_odd,
    vanishes_at_zero,
)
from stringcast.stages.model.effects.contact import Contact


class BoxContact(StringEffect):
    """A box that pushes points out, with loss and friction as in `contact`.

    The force per mass is k d along the gradient of the depth d, 1/d^2 = 1/a^2 + 1/b^2,
    with the distances a and b from the nearer vertical and horizontal side. Its
    potential is k d^2 / 2. Near a side d is the distance from it; near a corner the
    force turns smoothly from one side to the other. With the smaller of a and b
    instead, the force jumps across the diagonals, and a step of 0.1 ms there gained up
    to 3 % of a point's energy instead of 0.2 %. A point at speed v enters to the depth
    v / sqrt(k); beyond the middle it leaves on the other side. Mass points touch; the
    segments between them do not.
    """

    name = "box_contact"
    exclusion_reason = (
        "obstacles are known settings; a search would mistake any contact for one"
    )
    parameters = (
        Parameter(
            "stiffness",
            "1/s2",
            "contact force over mass, per depth",
            0.0,
            1.0e5,
            0.0,
        ),
        Parameter("centre_x", "m", "x of the box's centre", -1.5, 1.5, 0.0),
        Parameter("centre_y", "m", "y of the box's centre", -1.5, 1.5, 0.0),
        Parameter("width", "m", "full width of the box", 0.0, 1.0, 0.1),
        Parameter("height", "m", "full height of the box", 0.0, 1.0, 0.1),
        Parameter("friction", "1", "friction coefficient", 0.0, 1.0, 0.0),
        Parameter(
            "loss", "s/m", "relative loss of force per speed of impact", 0.0, 0.5, 0.0
        ),
    )
    reference = Contact.reference
    invariants = (
        vanishes_at_zero("load", "stiffness"),
        is_odd("load", "x", "y", "vx", "vy", "centre_x", "centre_y"),
    )
    # The potential curves most near a side, by k.
    bound = staticmethod(Contact.bound)

    @staticmethod
    def describe(values: Values) -> str:
        size = f"{values['width']:.3f} m wide and {values['height']:.3f} m high"
        return (
            f"the string touches a box {size} at ({values['centre_x']:.3f}, "
            f"{values['centre_y']:.3f}) m"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the static force along a horizontal line through the centre."""
        place = np.linspace(-0.7, 0.7, 281) * values["width"]
        given = {"friction": 0.0, "loss": 0.0} | cls.derive_parameters(
            values["width"], values["height"]
        )
        push = cls.load(
            place, 0.0, 0.0, 0.0, 0.0, values["stiffness"], 0.0, 0.0, **given
        )[0]
        draw_line(axes, values["centre_x"] + place, push, "x [m]", "push [m/s2]")

    @staticmethod
    def derive_parameters(
        width: Quantity, height: Quantity, **others: Quantity
    ) -> dict[str, Quantity]:
        """Return the distances from the centre to the sides [m]."""
        return {"half_width": 0.5 * width, "half_height": 0.5 * height}

    @staticmethod
    def load(
        x: Quantity,
        y: Quantity,
        vx: Quantity,
        vy: Quantity,
        dt: Quantity,
        stiffness: Quantity,
        centre_x: Quantity,
        centre_y: Quantity,
        friction: Quantity,
        loss: Quantity,
        half_width: Quantity,
        half_height: Quantity,
    ) -> tuple[Quantity, Quantity]:
        right, up = x - centre_x, y - centre_y
        a = np.maximum(half_width - np.abs(right), 0.0)
        b = np.maximum(half_height - np.abs(up), 0.0)
        # The last term avoids 0 / 0.
        over = 1.0 / np.sqrt(a * a + b * b + 1e-30)
        out_x = np.sign(right) * (b * over) ** 3
        out_y = np.sign(up) * (a * over) ** 3
        push = (
            stiffness
            * a
            * b
            * over
            * np.maximum(1.0 - loss * (out_x * vx + out_y * vy), 0.0)
        )
        sliding = out_y * vx - out_x * vy
        limit = friction * push
        smoothing = np.maximum(2.0 * limit * dt, 0.1)  # [m/s], as in `contact`
        tangential = (
            limit * sliding / np.sqrt(sliding * sliding + smoothing * smoothing)
        )
        return push * out_x - tangential * out_y, push * out_y + tangential * out_x
