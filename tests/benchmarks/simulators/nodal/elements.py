"""Cubic Hermite elements: nodes carry position and slope, so the tangent is continuous.

Gerstmayr and Shabana, Analysis of thin beams and cables using the absolute nodal
co-ordinate formulation (2006); here with curvature and stretch per unstretched length,
and consistent masses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss

from tests.benchmarks.simulators.nodal.assembly import Elements
from tests.benchmarks.simulators.rod import Rod

GAUSS_POINTS = 4  # exact for the mass matrix of even density, of degree 6


def hermite(place: np.ndarray, element: float) -> np.ndarray:
    """Return shape functions and two derivatives by arc length, (M, 3, 4).

    `place` (M,) is in [0, 1]. `element` is its length [m].
    """
    x, h = place, element
    value = np.stack(
        [
            1 - 3 * x**2 + 2 * x**3,
            h * (x - 2 * x**2 + x**3),
            3 * x**2 - 2 * x**3,
            h * (x**3 - x**2),
        ],
        axis=-1,
    )
    first = np.stack(
        [
            (6 * x**2 - 6 * x) / h,
            1 - 4 * x + 3 * x**2,
            (6 * x - 6 * x**2) / h,
            3 * x**2 - 2 * x,
        ],
        axis=-1,
    )
    second = np.stack(
        [(12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h],
        axis=-1,
    )
    return np.stack([value, first, second], axis=1)


@dataclass(frozen=True)
class Mesh:
    """A rod of equal elements.

    Parameters
    ----------
    rod : the string
    elements : their number E
    shapes : (G, 3, 4) shape functions and two derivatives at the Gauss points
    weights : (G,) of the Gauss points [m]
    places : (E, G) their arc lengths [m]
    mass : (D, D) of one coordinate over nominal mass per length [m]; D = 2 (E + 1)
    """

    rod: Rod
    elements: int
    shapes: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    mass: np.ndarray

    @staticmethod
    def of_rod(rod: Rod, elements: int) -> Mesh:
        """Divide a rod into so many elements."""
        nodes, weights = leggauss(GAUSS_POINTS)
        place = (nodes + 1) / 2
        h = rod.length / elements
        places = h * (np.arange(elements)[:, None] + place)
        shapes = hermite(place, h)
        mesh = Mesh(rod, elements, shapes, h * weights / 2, places, np.zeros((0, 0)))
        density = 1 + rod.taper * (places / rod.length - 0.5)
        mass = mesh.integrate_shapes(density)
        mass[-2, -2] += rod.tip_mass * rod.length
        bead = mesh.position_weights(np.array([rod.bead_place]))[0]
        mass += rod.bead_mass * rod.length * np.outer(bead, bead)
        return replace(mesh, mass=mass)

    def integrate_shapes(self, density: np.ndarray) -> np.ndarray:
        """Integrate density (E, G) times products of the shape functions, (D, D)."""
        coordinates = 2 * self.elements + 2
        integral = np.zeros((coordinates, coordinates))
        shape = self.shapes[:, 0]
        for e in range(self.elements):
            part = slice(2 * e, 2 * e + 4)
            weights = self.weights * density[e]
            integral[part, part] += np.einsum("g,gi,gj->ij", weights, shape, shape)
        return integral

    @cached_property
    def weight(self) -> np.ndarray:
        """Return gravity on the coordinates over nominal mass per length.

        It has shape (D, 2) [m2/s2].
        """
        gravity = [self.rod.gravity_x, self.rod.gravity_y]
        return np.outer(self.mass[:, ::2].sum(axis=1), gravity)

    @property
    def as_elements(self) -> Elements:
        """Return the elements as compiled code takes them."""
        return Elements(self.shapes, self.weights, self.places, self.mass, self.weight)

    def position_weights(self, arc: np.ndarray) -> np.ndarray:
        """Return the weights (S, D) of coordinates in positions at arc lengths (S,)."""
        h = self.rod.length / self.elements
        element = np.minimum((arc / h).astype(int), self.elements - 1)
        weights = np.zeros((len(arc), 2 * self.elements + 2))
        shapes = hermite(arc / h - element, h)[:, 0]
        for row, e in enumerate(element):
            weights[row, 2 * e : 2 * e + 4] = shapes[row]
        return weights
