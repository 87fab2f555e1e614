"""The paper's forces in the paper's units."""

import numpy as np
import pytest

from stringcast.stages.model.string import String

PARAMETERS = {
    p.name: 0.7 * np.sqrt(p.low * p.high) + 0.3 * p.high for p in String(0.3).parameters
}


def test_the_kernel_uses_the_units_of_equation_1():
    """Units in the kernel are those of Equation 1.

    At n = 10 a law's material form is the paper's force per unit mass of a mass point.
    """
    string = String(0.3)
    values = string.values(PARAMETERS)
    material = dict(zip(string.names, string.material(values), strict=True))
    length, stretch, angle = string.segment_length, 1e-3, 0.2
    assert material["axial_stiffness"] * (stretch / length) / length == pytest.approx(
        PARAMETERS["axial_stiffness"] * stretch
    )
    moment = material["bending_stiffness"] * (angle / length) / length
    assert moment / length == pytest.approx(
        PARAMETERS["bending_stiffness"] * angle / length
    )
    assert material["grasp_stiffness"] * angle / length == pytest.approx(
        PARAMETERS["grasp_stiffness"] * angle
    )


@pytest.mark.parametrize("points", [10, 25])
def test_the_papers_units_are_exact_at_reference_points(points):
    """The paper's units are exact at its own n.

    With reference_points == points, what is given per mass point is what acts on it.
    """
    string = String(0.3, points=points, reference_points=points)
    same = string.material(string.start_values()) / string.segment_length ** np.array(
        [p.length_power for p in string.parameters]
    )
    np.testing.assert_allclose(same, string.start_values(), rtol=1e-12)
