"""A rolling shutter: rows are exposed one after another."""

import numpy as np

from stringcast.stages.model.effect import (
    Axes,
    Camera,
    CameraEffect,
    Parameter,
    Quantity,
    Values,
    draw_line,
    reduces_to,
)


class RollingShutter(CameraEffect):
    """A delay of rows: row v of H is exposed (v / H - stamped) readout after the stamp.

    v counts from the top. Points move at constant velocity in the meantime. A camera's
    stamp is the time of its first, middle or last row.
    """

    name = "rolling_shutter"
    # First, because velocities are not rotated or scaled.
    order = -1
    parameters = (
        Parameter(
            "readout",
            "s",
            "time from the exposure of the top row to the bottom row",
            -0.02,
            0.02,
            0.0,
            typical_size=0.01,
        ),
        Parameter(
            "stamped",
            "1",
            "row exposed at the frame's time, from the top, over the height",
            0.0,
            1.0,
            0.5,
        ),
    )
    reference = (
        "Meingast, Geyer and Sastry, Geometric models of rolling-shutter cameras (2005)"
    )
    invariants = (reduces_to("observe", "points", "velocity"),)

    @staticmethod
    def describe(values: Values) -> str:
        order = "top to bottom" if values["readout"] > 0 else "bottom to top"
        return (
            f"the camera has a rolling shutter: rows are exposed from {order} within "
            f"{1e3 * abs(values['readout']):.2f} ms"
        )

    @classmethod
    def plot(cls, axes: Axes, values: Values) -> None:
        """Draw the time at which each row is exposed."""
        row = np.linspace(0.0, 1.0, 2)
        delay = values["readout"] * (row - values["stamped"])
        draw_line(
            axes, row, delay, "row / height", "exposed after the frame's time [s]"
        )

    @staticmethod
    def observe(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        readout: Quantity,
        stamped: Quantity,
    ) -> np.ndarray:
        """Return the positions of points at the exposure of their rows.

        delay = readout (row + rowspeed delay), solved for the delay.
        """
        row = camera.pixels(points)[..., 1:] / camera.height - stamped
        speed = -velocity[..., 1:] * camera.px_per_m / camera.height
        return points + velocity * readout * row / (1 - readout * speed)
