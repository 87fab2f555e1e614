"""Centre-line: the ordered line from the grasp to the tip, to a fraction of a pixel.

The string's pixels are a graph. Depth is the cost of the cheapest way from the grasp,
dear where the string is faint, so that ways run along its ridge; the tip is the deepest
pixel and the way to it is the centre-line (the search from the grasp of IV-B). Each
point is then moved to the centroid of brightness across the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from stringcast.stages.common import mad_sigma
from stringcast.stages.extract.uncertainty import centroid_sigma, point_sigmas

NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
MAX_GAP_PX = 7  # [px] across which a broken string is joined
FAINT_PENALTY = 3.0  # how much dearer the string's faintest pixel is than its brightest
# how dear a pixel outside the mask is: a gap is bridged, a loop is not cut short
UNSEEN_PENALTY = 20.0
# [px] before the tip over which the string's light is compared with that beyond it
END_MARGIN_PX = 10.0
# [px] into an outline as far as which a line is better carried on than read
EXTENSION_PX = 5.0
# [px] by how much light may end elsewhere than the string, for the shape of its end
SHAPE_TOLERANCE = 0.2
HALF_WIDTHS = 4.0  # [px] least half width of the profile across the line


class UnreadableError(Exception):
    """The frame cannot be read; the message is the reason."""


def cumulative_length(points: np.ndarray) -> np.ndarray:
    """Arc length of each point of a line (K, 2) from its first, (K,), in their unit."""
    return np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    )


@dataclass(frozen=True)
class Centreline:
    """points: (K, 2) [px], from the grasp to the tip. sigma: (K,) of a coordinate [px].
    light: (K,) in all across the line, which blur does not change [grey levels half
    pixels]; NaN where an outline may add to it.
    """

    points: np.ndarray
    sigma: np.ndarray
    light: np.ndarray

    @property
    def depth(self) -> np.ndarray:
        """(K,) length along the line from its start [px]."""
        return cumulative_length(self.points)


@dataclass(frozen=True)
class CrossProfile:
    """Profiles of light across a line, (K,) each.

    shift: of the string's middle, sigma: its standard deviation [px]. light: in all
    [grey levels half pixels]. blind: an outline hides which light is the string's.
    lost: nothing is read there, and the line is carried on.
    """

    shift: np.ndarray
    sigma: np.ndarray
    light: np.ndarray
    blind: np.ndarray
    lost: np.ndarray


def trace_line(
    difference: np.ndarray,
    mask: np.ndarray,
    limb: np.ndarray,
    grasp: np.ndarray,
    start_radius: float,
) -> np.ndarray:
    """Pixels (K, 2) as (u, v) from the grasp to the tip. grasp: (2,) [px].

    limb: (height, width) bool, where the arm is: the string may go on in front of it
    unseen.
    """
    allowed = (cv2.dilate(mask, np.ones((MAX_GAP_PX, MAX_GAP_PX), np.uint8)) > 0) | limb
    rows, columns = np.nonzero(allowed)
    inside = mask[rows, columns] > 0
    if not inside.any():
        raise UnreadableError("no string in view")
    distance = np.hypot(columns - grasp[0], rows - grasp[1])
    if distance[inside].min() > start_radius:
        raise UnreadableError("no string at the grasp")
    # all that is allowed
    near = np.s_[rows[0] : rows[-1] + 1, columns.min() : columns.max() + 1]
    graph = _pixel_graph(difference[near], mask[near], allowed[near])
    depth, before = dijkstra(
        graph, indices=int(np.argmin(distance)), return_predecessors=True
    )

    # it may end at the deepest pixel of each patch; the way is taken that lies most in
    # the mask
    depth = np.where(np.isfinite(depth) & inside, depth, -1.0)
    patch = cv2.connectedComponents(mask, connectivity=8)[1][rows, columns]
    order = np.argsort(depth, kind="stable")[::-1]
    ends = order[np.unique(patch[order], return_index=True)[1]]
    ways = []
    for end in ends[depth[ends] >= 0]:
        way = [int(end)]
        while before[way[-1]] >= 0:
            way.append(int(before[way[-1]]))
        ways.append(way[::-1])
    best = max(ways, key=lambda way: np.sum(np.where(inside[way], 1, -1)))
    return np.concatenate([grasp[None], np.stack([columns, rows], axis=-1)[best[1:]]])


def refine_line(
    light: np.ndarray, outline: np.ndarray, way: np.ndarray, noise: float, half: float
) -> Centreline:
    """Move points to the centroid of brightness across the line, and its end to the
    string's.

    outline: (height, width) bool, where brightness does not tell; there the line is
    carried across. noise: one sigma [grey levels]. half: half the string's width [px].
    """
    # the deepest pixel of a wide end is its corner
    kept = max(len(way) - int(np.ceil(1.5 * half)), 2)
    rough = gaussian_filter1d(way[:kept], max(2.0, half / 2), axis=0, mode="nearest")
    first = _centre_points(
        light, outline, _extend_line(rough, half, 2 * half + 4), noise, half
    )
    if np.isnan(first.light[-1]):
        return first  # its end is hidden: there is nothing to carry it on from
    # an end cut aslant is not lit on both sides
    firm = max(len(first.points) - 1 - int(np.ceil(half)), 2)
    depth = first.depth[:firm]
    at = np.linspace(0, depth[-1], max(round(depth[-1]) + 1, 2))
    # a pixel a point
    evenly = np.stack(
        [np.interp(at, depth, first.points[:firm, i]) for i in (0, 1)], axis=-1
    )
    return _centre_points(
        light, outline, _extend_line(evenly, half, 3 * half + 5), noise, half
    )


def _centre_points(
    light: np.ndarray,
    outline: np.ndarray,
    smooth: np.ndarray,
    noise: float,
    half: float,
) -> Centreline:
    """One step of `refine`. smooth: (K, 2) [px], a pixel a point, on beyond the
    string's end.
    """
    tangent = np.gradient(smooth, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    seen = _cross_profiles(light, outline, smooth, normal, noise, half)
    end, end_sigma = _find_end(seen.light, seen.blind, half)
    whole = int(end) + 1
    firm = max(whole - int(np.ceil(half)), 1)
    shift = gaussian_filter1d(seen.shift[:firm], max(1.0, half / 3), mode="nearest")
    shift = np.pad(shift, (0, whole - firm), mode="edge")
    tip = (
        smooth[whole - 1]
        + (end % 1) * tangent[whole - 1]
        + shift[-1] * normal[whole - 1]
    )
    points = np.concatenate(
        [smooth[:whole] + shift[:, None] * normal[:whole], tip[None]]
    )
    each = np.append(np.arange(whole), whole - 1)  # the tip is as the point before it
    lit = np.where(seen.blind, np.nan, seen.light)[each]
    return Centreline(
        points, point_sigmas(seen.sigma[each], seen.lost[each], firm, end_sigma), lit
    )


def _cross_profiles(
    light: np.ndarray,
    outline: np.ndarray,
    line: np.ndarray,
    normal: np.ndarray,
    noise: float,
    half: float,
) -> CrossProfile:
    """Profiles across the line at each of its points (K, 2) [px]. normal: (K, 2) unit
    vectors.
    """
    reach = max(HALF_WIDTHS, 1.8 * half + 2)
    across = np.arange(-reach, reach + 0.25, 0.5)
    u, v = np.moveaxis(
        (line[:, None] + across[None, :, None] * normal[:, None]).astype(np.float32),
        -1,
        0,
    )
    bright = np.maximum(cv2.remap(light, u, v, cv2.INTER_LINEAR) - 2 * noise, 0)
    total = bright.sum(axis=1)
    shift = np.clip(
        (bright * across).sum(axis=1) / np.maximum(total, 1e-9), -reach, reach
    )
    covered = cv2.remap(outline.astype(np.float32), u, v, cv2.INTER_LINEAR)
    blind = covered[:, np.abs(across) <= half + 1].max(axis=1) > 0.5
    dark = total < 4 * noise
    lost = dark | (blind & (distance_transform_edt(dark | blind) < EXTENSION_PX))
    lost[0], shift[0] = False, 0.0  # the arm says where the string begins
    shift = np.interp(np.arange(len(shift)), np.flatnonzero(~lost), shift[~lost])
    return CrossProfile(
        shift, centroid_sigma(bright, across, lost, noise, half), total, blind, lost
    )


def _extend_line(line: np.ndarray, half: float, beyond: float) -> np.ndarray:
    """The line gone on straight, a pixel a point. beyond: as far as the string can end
    [px]: a hidden end is taken for half of what hides it.
    """
    last = line[-1 - int(max(6.0, 2 * half)) :]
    ahead = np.polyfit(np.arange(len(last)), last, 1)[0]
    ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
    return np.concatenate([line, line[-1] + np.arange(1, beyond)[:, None] * ahead])


def _find_end(light: np.ndarray, blind: np.ndarray, half: float) -> tuple[float, float]:
    """Where along a line, in points, its light falls to half, and one sigma of that.

    Blur along the string fades its end; half is where it is in the middle of the
    exposure, however fast it moved. An end that an outline blinds lies anywhere in
    there.
    """
    first = max(len(light) - int(4 * half + 4 + END_MARGIN_PX), 0)
    level = float(np.percentile(light[first:], 75)) / 2
    last = int(np.flatnonzero(light >= level)[-1])
    even = light[first : max(last - int(2 * half), first + 1)]
    beyond = int(np.argmin(np.append(blind[last + 1 :], False)))
    if beyond or last + 1 == len(light):
        # one sigma of anywhere along so many points
        return last + beyond / 2, max(beyond, 1) / np.sqrt(12)
    drop = float(light[last] - light[last + 1])
    return last + float(light[last] - level) / drop, float(
        np.hypot(SHAPE_TOLERANCE, mad_sigma(even - 2 * level) / drop)
    )


def _pixel_graph(
    difference: np.ndarray, mask: np.ndarray, allowed: np.ndarray
) -> coo_array:
    """Steps between neighbouring allowed pixels, priced by length and faintness."""
    number = np.full(allowed.shape, -1)
    count = int(allowed.sum())
    number[allowed] = np.arange(count)
    bright = np.minimum(
        difference / max(float(np.percentile(difference[allowed], 95)), 1e-6), 1.0
    )
    price = np.where(
        mask[allowed] > 0, 1 + FAINT_PENALTY * (1 - bright[allowed]), UNSEEN_PENALTY
    )
    padded = np.pad(number, 1, constant_values=-1)
    inner = padded[1:-1, 1:-1]
    a, b, w = [], [], []
    for dv, du in NEIGHBOURS:
        other = padded[
            1 + dv : padded.shape[0] - 1 + dv, 1 + du : padded.shape[1] - 1 + du
        ]
        joined = (inner >= 0) & (other >= 0)
        first, second = inner[joined], other[joined]
        a.append(first)
        b.append(second)
        w.append(np.hypot(dv, du) * (price[first] + price[second]) / 2)
    first, second, weight = np.concatenate(a), np.concatenate(b), np.concatenate(w)
    both = (
        np.concatenate([weight, weight]),
        (np.concatenate([first, second]), np.concatenate([second, first])),
    )
    return coo_array(both, shape=(count, count)).tocsr()
