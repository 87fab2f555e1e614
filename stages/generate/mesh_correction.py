"""The error of the mesh on planned motions.

An estimate at the mesh limit has the parameters of the string itself. The string that
is planned with has a mesh, whose error moves the tip: that of string D by 47 mm in a
cast. Strings on finer meshes, one for each motion, show this error (Richardson
extrapolation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stringcast.stages.generate.curves import Curves
from stringcast.stages.inference.mesh import extrapolate_error, refine_mesh
from stringcast.stages.model.hand import JointMotion
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class MeshCorrection:
    """The correction of simulated tips for the error of the mesh.

    Parameters
    ----------
    values : (P,) values of the parameters at which the error is computed
    factors : of the number of segments, ascending from 1; from two meshes a limit is
        extrapolated, and a third one shows how uncertain it is
    """

    values: np.ndarray
    factors: Sequence[int]

    def tip_errors(self, model: Model, curves: Curves) -> tuple[np.ndarray, np.ndarray]:
        """Compute the error of the tip on M motions at T ticks, (M, T, 2) [m].

        Returns the limit minus the simulation, and the difference between the limits of
        the finest and the coarsest two meshes. They are NaN where a simulation
        diverges, so that the motion does not count as a hit.
        """
        tick = model.arm.tick
        angles, speeds = curves.sample(tick, float(curves.duration.max()))
        motion = JointMotion(0.0, tick, angles, speeds)
        times = np.arange(angles.shape[1]) * tick
        values = np.tile(self.values, (len(angles), 1))
        tips = []
        for factor in self.factors:
            finer, _ = refine_mesh(model, (), factor)
            tips.append(finer.simulate_string(motion, values, times).tip)
        return extrapolate_error(*tips)
