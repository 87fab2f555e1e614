"""Laws, for the library's kernel, of causes on the string outside the library.

Names and laws are those of `causes.py` and `nodal/loads.py`, and each parameter is the
field of `Rod` of its name. The library does not know these effects. Their numbers are
literals, for the kernel copies the text of a law.
"""

from __future__ import annotations

import numpy as np

from stringcast.stages.model.effect import Quantity, StringEffect
from stringcast.stages.model.parameter import Parameter
from tests.benchmarks.simulators.rod import Rod


def rod_parameters(*names: str) -> tuple[Parameter, ...]:
    """Return parameters that are absent at the values of a plain rod."""
    parameters = []
    for name in names:
        start = Rod._field_defaults[name]
        parameters.append(Parameter(name, "", "", -1e9, 1e9, start))
    return tuple(parameters)


class SoftSpot(StringEffect):
    """Bending stiffness is lost over a few centimetres."""

    name = "soft_spot"
    parameters = rod_parameters("soft_spot", "soft_spot_place")

    @staticmethod
    def moment(
        curvature: Quantity,
        bending_stiffness: Quantity,
        soft_spot: Quantity,
        soft_spot_place: Quantity,
        s: Quantity = 0.0,
    ) -> Quantity:
        z = (s - soft_spot_place) / 0.025
        return -soft_spot * np.exp(-z * z) * bending_stiffness * curvature


class Attraction(StringEffect):
    """A place attracts the string within its reach, or repels it."""

    name = "attraction"
    parameters = rod_parameters(
        "attraction", "attraction_x", "attraction_y", "attraction_reach"
    )

    @staticmethod
    def load(
        x: Quantity,
        y: Quantity,
        attraction: Quantity,
        attraction_x: Quantity,
        attraction_y: Quantity,
        attraction_reach: Quantity,
    ) -> tuple[Quantity, Quantity]:
        dx = (attraction_x - x) / attraction_reach
        dy = (attraction_y - y) / attraction_reach
        force = 1.65 * attraction * np.exp(-0.5 * (dx * dx + dy * dy))
        return force * dx, force * dy


class Vortex(StringEffect):
    """Air turns about a place."""

    name = "vortex"
    parameters = rod_parameters("vortex", "vortex_x", "vortex_y", "vortex_core")

    @staticmethod
    def flow(
        x: Quantity,
        y: Quantity,
        vortex: Quantity,
        vortex_x: Quantity,
        vortex_y: Quantity,
        vortex_core: Quantity,
    ) -> tuple[Quantity, Quantity]:
        dx = (x - vortex_x) / vortex_core
        dy = (y - vortex_y) / vortex_core
        speed = 1.65 * vortex * np.exp(-0.5 * (dx * dx + dy * dy))
        return -speed * dy, speed * dx


class Gust(StringEffect):
    """The air moves everywhere for a tenth of a second."""

    name = "gust"
    parameters = rod_parameters("gust_x", "gust_y", "gust_when", "gust_lasts")

    @staticmethod
    def flow(
        t: Quantity,
        gust_x: Quantity,
        gust_y: Quantity,
        gust_when: Quantity,
        gust_lasts: Quantity,
    ) -> tuple[Quantity, Quantity]:
        z = (t - gust_when) / gust_lasts
        share = np.exp(-z * z)
        return share * gust_x, share * gust_y


class Blow(StringEffect):
    """A short force acts on a short part of the string."""

    name = "blow"
    parameters = rod_parameters("blow_x", "blow_y", "blow_when", "blow_place")

    @staticmethod
    def load(
        s: Quantity,
        t: Quantity,
        blow_x: Quantity,
        blow_y: Quantity,
        blow_when: Quantity,
        blow_place: Quantity,
    ) -> tuple[Quantity, Quantity]:
        z = (t - blow_when) / 0.008
        w = (s - blow_place) / 0.025
        share = np.exp(-z * z - w * w)
        return share * blow_x, share * blow_y


class Grip(StringEffect):
    """Fingers brake a short part of the string for a moment."""

    name = "grip"
    parameters = rod_parameters("grip", "grip_from", "grip_until", "grip_place")

    @staticmethod
    def bound(grip: Quantity, **others: Quantity) -> tuple[Quantity, Quantity]:
        """Return the squared frequency and the damping rate that it adds at most."""
        return 0.0 * grip, grip

    @staticmethod
    def load(
        vx: Quantity,
        vy: Quantity,
        s: Quantity,
        t: Quantity,
        grip: Quantity,
        grip_from: Quantity,
        grip_until: Quantity,
        grip_place: Quantity,
    ) -> tuple[Quantity, Quantity]:
        since = 1.0 + np.tanh((t - grip_from) / 0.004)
        until = 1.0 - np.tanh((t - grip_until) / 0.004)
        w = (s - grip_place) / 0.015
        brake = 0.25 * grip * since * until * np.exp(-w * w)
        return -brake * vx, -brake * vy


OUTSIDE_EFFECTS: tuple[type[StringEffect], ...] = (
    SoftSpot,
    Attraction,
    Vortex,
    Gust,
    Blow,
    Grip,
)
