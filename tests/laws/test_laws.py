"""Each force by itself: odd, at rest at rest, blind to direction, and a damper only takes energy."""

import numpy as np
import pytest

from stages.model.effect import arguments
from stages.model.string import BASE, String

PARAMETERS = {p.name: 0.7 * np.sqrt(p.low * p.high) + 0.3 * p.high for p in String(0.3).parameters}
PAIRS = {"tension": ("stretch", "rate"), "moment": ("curvature", "rate"), "grasp_moment": ("angle", "rate")}
LAWS = [(effect, slot) for effect in BASE for slot in effect.laws()]


def value(effect, slot, **given):
    law = effect.laws()[slot]
    return law(**{a: given.get(a, PARAMETERS.get(a)) for a in arguments(law)})


@pytest.mark.parametrize(("effect", "slot"), [pair for pair in LAWS if pair[1] in PAIRS], ids=str)
def test_inner_forces_are_odd_and_zero_at_rest(effect, slot):
    first, second = PAIRS[slot]
    for a, b in np.random.default_rng(0).normal(size=(20, 2)):
        assert value(effect, slot, **{first: a, second: b}) == -value(effect, slot, **{first: -a, second: -b})
        # a spring pulls back, a damper only takes energy
        assert a * value(effect, slot, **{first: a, second: 0.0}) >= 0
        assert b * value(effect, slot, **{first: 0.0, second: b}) >= 0
        assert value(effect, slot, **{first: a, second: b}) != 0
    assert value(effect, slot, **{first: 0.0, second: 0.0}) == 0


@pytest.mark.parametrize(("effect", "slot"), [pair for pair in LAWS if pair[1] == "load"], ids=str)
def test_air_opposes_motion_alike_in_every_direction(effect, slot):
    for vx, vy, turn in np.random.default_rng(1).normal(size=(20, 3)) * 5:
        c, s = np.cos(turn), np.sin(turn)
        f = np.array(value(effect, slot, vx=vx, vy=vy))
        turned = value(effect, slot, vx=c * vx - s * vy, vy=s * vx + c * vy)
        np.testing.assert_allclose(turned, [c * f[0] - s * f[1], s * f[0] + c * f[1]], rtol=1e-12)
        assert f @ [vx, vy] < 0


def test_units_in_the_kernel_are_those_of_equation_1():
    """At n = 10 a law's material form gives back the paper's force per unit mass of a mass point."""
    string = String(0.3)
    values = string.values(PARAMETERS)
    material = dict(zip(string.names, string.material(values), strict=True))
    length, stretch, angle = string.segment, 1e-3, 0.2
    assert material["axial_stiffness"] * (stretch / length) / length == pytest.approx(
        PARAMETERS["axial_stiffness"] * stretch
    )
    moment = material["bending_stiffness"] * (angle / length) / length
    assert moment / length == pytest.approx(PARAMETERS["bending_stiffness"] * angle / length)
    assert material["grasp_stiffness"] * angle / length == pytest.approx(PARAMETERS["grasp_stiffness"] * angle)


@pytest.mark.parametrize("points", [10, 25])
def test_the_papers_view_is_exact_at_its_own_n(points):
    """reference_points == points: what is given per mass point is what acts on it."""
    string = String(0.3, points=points, reference_points=points)
    same = string.material(string.start()) / string.segment ** np.array([p.per_length for p in string.parameters])
    np.testing.assert_allclose(same, string.start(), rtol=1e-12)
