"""Corrections of the directions of x and y."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stringcast.stages.check.consistency.corrections.base import Correction
from stringcast.stages.check.consistency.record import Measurements, Recording, Track


class PointDirections(Correction):
    """Directions of the points are wrong, but not those of the hand.

    matrix: (2, 2), maps positions to right ones.
    """

    table = "points"
    matrix: np.ndarray

    def undo(self, measured: Measurements) -> Measurements | None:
        return map_points(measured, self.matrix)


class YDown(PointDirections):
    """The points' y counts down."""

    field = "y"
    statement = "y points down, not up"
    remedy = "Multiply y by -1"
    matrix = np.diag([1.0, -1.0])


class XLeft(PointDirections):
    """The points' x counts to the left."""

    field = "x"
    statement = "x points to the left, not to the right"
    remedy = "Multiply x by -1"
    matrix = np.diag([-1.0, 1.0])


class ExchangedAxes(PointDirections):
    """The points' x and y are exchanged."""

    field = "x, y"
    statement = "x and y have changed places"
    remedy = "Exchange the two columns"
    matrix = np.array([[0.0, 1.0], [1.0, 0.0]])


class WorldUpsideDown(Correction):
    """The y of a measured hand and of the points counts down."""

    table = "grasp"
    field = "y, theta"
    statement = "y of the hand and of the points points down, not up"
    remedy = "Multiply y of both by -1, and theta too"

    def undo(self, measured: Measurements) -> Measurements | None:
        if measured.has_joints:
            return None
        flip = np.array([1.0, -1.0, -1.0])  # of x, y and theta

        def mirror(recording: Recording) -> Recording:
            assert recording.hand is not None
            return replace(recording, hand=recording.hand * flip)

        return map_points(measured, YDown.matrix).with_recordings(mirror)


def map_points(measured: Measurements, matrix: np.ndarray) -> Measurements:
    """Multiply positions of points by a matrix (2, 2)."""

    def map_track(track: Track) -> Track:
        return replace(track, xy=track.xy @ matrix.T)

    return measured.with_tracks(map_track)


DIRECTIONS = (YDown(), XLeft(), ExchangedAxes(), WorldUpsideDown())
