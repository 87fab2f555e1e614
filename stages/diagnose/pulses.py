"""Pulses in time: what is missing, in pieces. Not causes, so not in the library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import CameraEffect, HandEffect, Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.picture import line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WHEN = (
    Parameter("at_t", "s", "middle of the pulse", -10.0, 1000.0, 0.0),
    Parameter("over_t", "s", "its standard deviation in time", 0.0, 10.0, 1.0),
)


def bell(t: Quantity, at: Quantity, over: Quantity) -> Quantity:
    """A Gaussian pulse of height 1."""
    return np.exp(-(((t - at) / over) ** 2) / 2)


class _Pulse:
    """What pulses have in common."""

    reference = "Gaussian pulse"

    @staticmethod
    def words(values: Mapping[str, float]) -> str:
        """What is so."""
        return f"a pulse of ({values['along_x']:.3g}, {values['along_y']:.3g}) at {values['at_t']:.2f} s"

    @classmethod
    def plot(cls, axes: Axes, values: Mapping[str, float]) -> None:
        """The pulse over time."""
        t = values["at_t"] + values["over_t"] * np.linspace(-4, 4, 101)
        size = np.hypot(values["along_x"], values["along_y"])
        line(axes, t, size * bell(t, values["at_t"], values["over_t"]), "time / s", "size")


class Push(_Pulse, StringEffect):
    """A push on a part of the string."""

    name = "force"
    parameters = (
        Parameter("along_x", "m/s2", "push over mass", -1e3, 1e3, 0.0),
        Parameter("along_y", "m/s2", "push over mass", -1e3, 1e3, 0.0),
        *WHEN,
        Parameter("at_s", "m", "arc length of its middle", -1.0, 10.0, 0.0),
        Parameter("over_s", "m", "its standard deviation along the string", 0.0, 10.0, 1.0),
    )

    @staticmethod
    def load(
        s: Quantity,
        t: Quantity,
        along_x: Quantity,
        along_y: Quantity,
        at_t: Quantity,
        over_t: Quantity,
        at_s: Quantity,
        over_s: Quantity,
    ) -> tuple[Quantity, Quantity]:
        off_t, off_s = (t - at_t) / over_t, (s - at_s) / over_s
        size = np.exp(-(off_t * off_t + off_s * off_s) / 2)
        return along_x * size, along_y * size


class GraspShift(_Pulse, HandEffect):
    """The grasp is elsewhere for a while."""

    name = "motion of the grasp"
    parameters = (
        Parameter("along_x", "m", "shift of the grasp", -1.0, 1.0, 0.0),
        Parameter("along_y", "m", "shift of the grasp", -1.0, 1.0, 0.0),
        *WHEN,
    )

    @staticmethod
    def grasp(
        t: np.ndarray, pose: np.ndarray, along_x: Quantity, along_y: Quantity, at_t: Quantity, over_t: Quantity
    ) -> np.ndarray:
        """Only the place changes."""
        shift = np.concatenate([along_x, along_y, 0 * along_x], axis=-1)
        return pose + bell(t[:, None], at_t, over_t) * shift


class PictureShift(_Pulse, CameraEffect):
    """The whole picture is elsewhere for a while."""

    name = "shift of the picture"
    parameters = (
        Parameter("along_x", "m", "shift of what is seen", -1.0, 1.0, 0.0),
        Parameter("along_y", "m", "shift of what is seen", -1.0, 1.0, 0.0),
        *WHEN,
    )

    @staticmethod
    def seen(
        points: np.ndarray,
        velocity: np.ndarray,
        times: np.ndarray,
        camera: Camera,
        along_x: Quantity,
        along_y: Quantity,
        at_t: Quantity,
        over_t: Quantity,
    ) -> np.ndarray:
        """All points alike."""
        return points + bell(times[None, :, None, None], at_t, over_t) * np.concatenate([along_x, along_y], axis=-1)
