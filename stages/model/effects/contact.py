"""A floor or a wall that the string touches."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Parameter,
    Quantity,
    StringEffect,
    Values,
    draw_line,
    vanishes_at_zero,
)

# A string at rest sinks in by 10 mm. A softer plane is rather a field of force.
SOFTEST_PER_S2 = 981.0


class Contact(StringEffect):
    """A plane with the contact force k d (1 - a v_n) per mass, and friction.

    d is the depth and v_n the velocity out of the plane. The force never pulls. Without
    the loss a it has a potential, so a bounce conserves energy; the loss only
    dissipates (Hunt and Crossley). Mass points touch; the segments between them do not.
    A string enters deeper between its points, so a plane appears softer than it is.

    Friction is Coulomb's, smoothed below 0.1 m/s, or below twice the change of speed by
    friction in a step dt: friction must not reverse a slide within a step. A point at
    speed v enters to the depth v / sqrt(k) (5 m/s: 16 mm at 1e5, 2.5 mm at 4e6), so k
    is searched evenly in its root.
    """

    name = "contact"
    parameters = (
        Parameter(
            "stiffness",
            "1/s2",
            "contact force over mass, per depth",
            0.0,
            1.0e7,
            0.0,
            root=2,
            is_lower_bound=True,
            min_amplitude=SOFTEST_PER_S2,
            typical_size=1.0e7,  # any stiffness is common
        ),
        Parameter(
            "height",
            "m",
            "distance of the plane from the world's origin, along its normal",
            -1.0,
            1.0,
            0.0,
        ),
        Parameter(
            "tilt",
            "rad",
            "angle of its normal from straight up: 0 is a floor, +-pi/2 a wall",
            -3.1,
            3.1,
            0.0,
        ),
        Parameter("friction", "1", "friction coefficient", 0.0, 1.0, 0.0),
        Parameter(
            "loss", "s/m", "relative loss of force per speed of impact", 0.0, 0.5, 0.0
        ),
    )
    reference = (
        "Hunt and Crossley, Coefficient of restitution interpreted as damping in "
        "vibroimpact (1975)"
    )
    invariants = (vanishes_at_zero("load", "stiffness"),)

    @staticmethod
    def describe(values: Values) -> str:
        turned = np.degrees(values["tilt"])
        # [mm], if it is a floor
        sinks = 1e3 * 9.81 / max(values["stiffness"], 1e-3)
        soft = (
            f", so soft that a string at rest sinks {sinks:.0f} mm into it"
            if round(sinks) >= 1
            else ""
        )
        return (
            f"the string touches a plane {values['height']:.3f} m from the origin, "
            f"turned {turned:.0f} degrees{soft}"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the static force over the position along the normal."""
        place = values["height"] + np.linspace(-0.01, 0.01, 101)
        push = cls.load(
            0.0,
            place,
            0.0,
            0.0,
            0.0,
            values["stiffness"],
            values["height"],
            0.0,
            0.0,
            0.0,
            1.0,
        )[1]
        draw_line(axes, place, push, "along the normal [m]", "force over mass [m/s2]")

    @staticmethod
    def derive_parameters(tilt: Quantity, **others: Quantity) -> dict[str, Quantity]:
        """Return the plane's normal."""
        return {"normal_x": -np.sin(tilt), "normal_y": np.cos(tilt)}

    @staticmethod
    def bound(
        stiffness: Quantity, loss: Quantity, **others: Quantity
    ) -> tuple[Quantity, Quantity]:
        """Bound impacts up to 10 m/s, to the depth v / sqrt(k).

        The law itself limits friction.
        """
        speed = 10.0
        return stiffness * (1 + loss * speed), loss * speed * np.sqrt(stiffness)

    @staticmethod
    def load(
        x: Quantity,
        y: Quantity,
        vx: Quantity,
        vy: Quantity,
        dt: Quantity,
        stiffness: Quantity,
        height: Quantity,
        friction: Quantity,
        loss: Quantity,
        normal_x: Quantity,
        normal_y: Quantity,
    ) -> tuple[Quantity, Quantity]:
        depth = np.maximum(height - normal_x * x - normal_y * y, 0.0)
        push = (
            stiffness
            * depth
            * np.maximum(1.0 - loss * (normal_x * vx + normal_y * vy), 0.0)
        )
        sliding = normal_y * vx - normal_x * vy
        limit = friction * push
        smoothing = np.maximum(2.0 * limit * dt, 0.1)  # [m/s]
        tangential = (
            limit * sliding / np.sqrt(sliding * sliding + smoothing * smoothing)
        )
        return (
            push * normal_x - tangential * normal_y,
            push * normal_y + tangential * normal_x,
        )
