"""Cubic Hermite elements: nodes carry position and slope dr/ds, so that the tangent is
continuous.

Gerstmayr and Shabana, Analysis of thin beams and cables using the absolute nodal
co-ordinate formulation (2006); here with curvature and stretch per unstretched length,
and consistent masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss

from tests.benchmarks.simulators.laboratory.nodal.dynamics import Elements
from tests.benchmarks.simulators.laboratory.rod import Rod

GAUSS = 4  # points in an element: exact for the mass matrix of even density, degree 6


def hermite(place: np.ndarray, element: float) -> np.ndarray:
    """Shape functions and their first two derivatives by arc length, (M, 3, 4). place:
    (M,) in [0, 1].
    """
    x, h = place, element
    value = [
        1 - 3 * x**2 + 2 * x**3,
        h * (x - 2 * x**2 + x**3),
        3 * x**2 - 2 * x**3,
        h * (x**3 - x**2),
    ]
    first = [
        (6 * x**2 - 6 * x) / h,
        1 - 4 * x + 3 * x**2,
        (6 * x - 6 * x**2) / h,
        3 * x**2 - 2 * x,
    ]
    second = [
        (12 * x - 6) / h**2,
        (6 * x - 4) / h,
        (6 - 12 * x) / h**2,
        (6 * x - 2) / h,
    ]
    return np.stack(
        [np.stack(each, axis=-1) for each in (value, first, second)], axis=1
    )


@dataclass(frozen=True)
class Mesh:
    """A rod of equal elements. shapes: (G, 3, 4). weights: (G,) [m]. places: (E, G) arc
    length of the Gauss points [m]. mass: (D, D) of one coordinate, over nominal mass
    per length [m]; D = 2 (elements + 1).
    """

    rod: Rod
    elements: int
    shapes: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    mass: np.ndarray

    @staticmethod
    def of(rod: Rod, elements: int) -> Mesh:
        """The rod in so many elements."""
        nodes, weights = leggauss(GAUSS)
        place, h = (nodes + 1) / 2, rod.length / elements
        places = h * (np.arange(elements)[:, None] + place)
        mesh = Mesh(
            rod, elements, hermite(place, h), h * weights / 2, places, np.zeros((0, 0))
        )
        density = 1 + rod.taper * (places / rod.length - 0.5)
        mass = mesh.integrated(0, density)
        mass[-2, -2] += rod.tip_mass * rod.length
        bead = mesh.at(np.array([rod.bead_place * rod.length]))[0]
        mass += rod.bead_mass * rod.length * np.outer(bead, bead)
        return Mesh(rod, elements, mesh.shapes, mesh.weights, places, mass)

    def integrated(self, derivative: int, density: np.ndarray) -> np.ndarray:
        """The integral of density (E, G) times products of a derivative of the shape
        functions, (D, D).
        """
        whole = np.zeros((2 * self.elements + 2, 2 * self.elements + 2))
        shape = self.shapes[:, derivative]
        for e in range(self.elements):
            part = slice(2 * e, 2 * e + 4)
            whole[part, part] += np.einsum(
                "g,gi,gj->ij", self.weights * density[e], shape, shape
            )
        return whole

    @cached_property
    def weight(self) -> np.ndarray:
        """Gravity on the nodal coordinates, over nominal mass per length, (D, 2)
        [m2/s2].
        """
        return np.outer(
            self.mass[:, ::2].sum(axis=1), [self.rod.gravity_x, self.rod.gravity_y]
        )

    @property
    def compiled(self) -> Elements:
        """The elements as `dynamics` takes them."""
        return Elements(self.shapes, self.weights, self.places, self.mass, self.weight)

    def at(self, arc: np.ndarray) -> np.ndarray:
        """Weights (S, D) of the nodal coordinates in positions at arc lengths (S,) [m]."""
        h = self.rod.length / self.elements
        element = np.minimum((arc / h).astype(int), self.elements - 1)
        weights = np.zeros((len(arc), 2 * self.elements + 2))
        shapes = hermite(arc / h - element, h)[:, 0]
        for row, (e, shape) in enumerate(zip(element, shapes, strict=True)):
            weights[row, 2 * e : 2 * e + 4] = shape
        return weights
