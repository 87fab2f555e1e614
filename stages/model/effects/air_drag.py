"""Air resistance, F_c of Table 1."""

import numpy as np

from stages.model.effect import StringEffect
from stages.model.parameter import Parameter


class AirDrag(StringEffect):
    """Still air resists with (C_c1 + C_c2 |v|) v, force over mass."""

    name = "air_drag"
    parameters = (
        Parameter("linear_drag", "N s/(m kg)", "air resistance, proportional", 1.0e-4, 10.0, 1.0e-4, "C_c1"),
        Parameter("quadratic_drag", "N s2/(m2 kg)", "air resistance, squared", 1.0e-4, 10.0, 1.0e-4, "C_c2"),
    )

    @staticmethod
    def load(vx: float, vy: float, linear_drag: float, quadratic_drag: float) -> tuple[float, float]:
        drag = linear_drag + quadratic_drag * np.sqrt(vx * vx + vy * vy)
        return -drag * vx, -drag * vy
