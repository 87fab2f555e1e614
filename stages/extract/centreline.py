"""Centre-line: the ordered line from the grasp to the tip, to a fraction of a pixel.

The string's pixels are a graph. The depth of a pixel is the cost of the cheapest path
from the grasp. Faint pixels cost more, so paths follow the ridge of brightness. The tip
is the deepest pixel, and the path to it is the centre-line (the search from the grasp
in IV-B). Each point is then moved to the centroid of brightness across the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.common import mad_sigma
from stringcast.stages.extract.segment import SegmentedFrame
from stringcast.stages.extract.uncertainty import centroid_sigma, point_sigmas
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.polyline import (
    step_lengths,
    turn_left,
    unit_tangents,
)

cv2 = LazyModule("cv2")

# Steps (d_v, d_u) to half of a pixel's neighbours; the other half is opposite.
NEIGHBOUR_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
MAX_GAP_PX = 7  # a wider gap in the string is not bridged
FAINT_PENALTY = 3.0  # extra cost of the faintest pixel, in costs of the brightest
# Cost of a pixel outside the mask, low enough for gaps, too high to cut off a loop.
UNSEEN_PENALTY = 20.0
# Length before the tip whose light is compared with that beyond the tip.
END_MARGIN_PX = 10.0
# Distance over which a line is extended into the arm's outline, without reading it.
EXTENSION_PX = 5.0
END_SHAPE_SIGMA_PX = 0.05  # of the end of the light; 0.03 to 0.05 on drawn lines
MIN_PROFILE_REACH_PX = 4.0  # smallest half width of the profile across the line


class UnreadableError(Exception):
    """The frame cannot be read. The message is the reason."""


def cumulative_length(points: np.ndarray) -> np.ndarray:
    """Compute the length along a line (K, 2) at each point, (K,)."""
    return np.concatenate([[0.0], np.cumsum(step_lengths(points))])


@dataclass(frozen=True)
class Centreline:
    """The line of the string from the grasp to the tip.

    Parameters
    ----------
    points : (K, 2) pixels (u, v)
    sigma : (K,) standard deviation of a coordinate [px]
    light : (K,) sum of light across the line, independent of blur [grey levels half
        pixels]; NaN where an outline may add to it
    """

    points: np.ndarray
    sigma: np.ndarray
    light: np.ndarray

    @property
    def depth(self) -> np.ndarray:
        """Length along the line from its start, (K,) [px]."""
        return cumulative_length(self.points)


@dataclass(frozen=True)
class CrossProfile:
    """Profiles of light across a line, (K,) each.

    Parameters
    ----------
    shift : of the string's middle from the line [px]
    sigma : standard deviation of the shift [px]
    light : sum of light above the noise across the line [grey levels half pixels]
    near_light : sum of all light close to the line [grey levels half pixels]
    outlined : whether the arm's outline may add light
    unseen : whether a point is not read, and the line is extended across it
    """

    shift: np.ndarray
    sigma: np.ndarray
    light: np.ndarray
    near_light: np.ndarray
    outlined: np.ndarray
    unseen: np.ndarray


def trace_line(
    light: np.ndarray,
    mask: np.ndarray,
    arm: np.ndarray,
    grasp: np.ndarray,
    start_radius: float,
) -> np.ndarray:
    """Trace the string's pixels from the grasp to the tip.

    Parameters
    ----------
    light : (height, width) array
        Brightness above the scene [grey levels].
    mask : (height, width) uint8 array
        Certain pixels of the string.
    arm : (height, width) bool array
        Pixels of the arm, in front of which the string may be invisible.
    grasp : (2,) array
        Pixel (u, v) of the grasp.
    start_radius : float
        Largest distance of the string from the grasp [px].

    Returns
    -------
    (K, 2) array
        Pixels (u, v) from the grasp on.

    Raises
    ------
    UnreadableError
        If no string is in view or at the grasp.
    """
    bridge = np.ones((MAX_GAP_PX, MAX_GAP_PX), np.uint8)
    allowed = (cv2.dilate(mask, bridge) > 0) | arm
    rows, columns = np.nonzero(allowed)
    inside = mask[rows, columns] > 0
    if not inside.any():
        raise UnreadableError("no string in view")
    distance = np.hypot(columns - grasp[0], rows - grasp[1])
    if distance[inside].min() > start_radius:
        raise UnreadableError("no string at the grasp")

    # Cheapest paths from the grasp, in the part of the picture with allowed pixels.
    left, right = columns.min(), columns.max()
    part = np.s_[rows[0] : rows[-1] + 1, left : right + 1]
    graph = _pixel_graph(light[part], mask[part], allowed[part])
    start = int(np.argmin(distance))
    depth, previous = dijkstra(graph, indices=start, return_predecessors=True)

    patch = cv2.connectedComponents(mask, connectivity=8)[1][rows, columns]
    path = _path_in_mask(depth, previous, inside, patch)
    pixels = np.stack([columns, rows], axis=-1)
    return np.concatenate([grasp[None], pixels[path[1:]]])


def _pixel_graph(light: np.ndarray, mask: np.ndarray, allowed: np.ndarray) -> coo_array:
    """Build the graph of allowed pixels, with a cost by length and faintness."""
    count = int(allowed.sum())
    number = np.full(allowed.shape, -1)
    number[allowed] = np.arange(count)
    full_light = max(float(np.percentile(light[allowed], 95)), 1e-6)
    brightness = np.clip(light / full_light, 0.0, 1.0)
    seen_cost = 1 + FAINT_PENALTY * (1 - brightness[allowed])
    cost = np.where(mask[allowed] > 0, seen_cost, UNSEEN_PENALTY)

    padded = np.pad(number, 1, constant_values=-1)
    pixels, others, weights = [], [], []
    for dv, du in NEIGHBOUR_STEPS:
        neighbour = np.roll(padded, (-dv, -du), axis=(0, 1))
        joined = (padded >= 0) & (neighbour >= 0)
        pixel, other = padded[joined], neighbour[joined]
        pixels.append(pixel)
        others.append(other)
        mean_cost = (cost[pixel] + cost[other]) / 2
        weights.append(np.hypot(dv, du) * mean_cost)
    start = np.concatenate(pixels + others)
    end = np.concatenate(others + pixels)
    weight = np.concatenate(weights + weights)
    return coo_array((weight, (start, end)), shape=(count, count)).tocsr()


def _path_in_mask(
    depth: np.ndarray, previous: np.ndarray, inside: np.ndarray, patch: np.ndarray
) -> list[int]:
    """Find the path to the deepest pixel of a patch with most pixels in the mask.

    Parameters
    ----------
    depth, previous : (N,) arrays
        Cost of the cheapest path to each pixel, and the previous pixel on that path.
    inside : (N,) bool array
        Whether a pixel is in the mask.
    patch : (N,) array of int
        Number of the patch of the mask.

    Returns
    -------
    list of int
        Pixels from the start to the end.
    """
    depth = np.where(np.isfinite(depth) & inside, depth, -1.0)
    deepest_first = np.argsort(depth, kind="stable")[::-1]
    _, first_of_patch = np.unique(patch[deepest_first], return_index=True)
    best: list[int] = []
    best_score = -np.inf
    for end in deepest_first[first_of_patch]:
        if depth[end] < 0:
            continue
        path = [int(end)]
        while previous[path[-1]] >= 0:
            path.append(int(previous[path[-1]]))
        score = np.sum(np.where(inside[path], 1, -1))
        if score > best_score:
            best, best_score = path[::-1], score
    return best


def refine_line(
    frame: SegmentedFrame, path: np.ndarray, half_width: float
) -> Centreline:
    """Move a traced line to the centroid of light across it, and its end to the tip.

    Parameters
    ----------
    frame : SegmentedFrame
        The string's light. The line is extended where the arm's outline makes it
        uncertain.
    path : (K, 2) array
        Traced pixels (u, v).
    half_width : float
        Half the string's width [px].

    Returns
    -------
    Centreline
        Points about a pixel apart, with their uncertainty.
    """
    # First pass, without the end: the deepest pixel of a wide end is its corner.
    read_count = max(len(path) - int(np.ceil(1.5 * half_width)), 2)
    smoothing = max(2.0, half_width / 2)
    line = gaussian_filter1d(path[:read_count], smoothing, axis=0, mode="nearest")
    fit_length = max(6.0, 2 * half_width)
    line = _extend_line(line, fit_length, 2 * half_width + 4, degree=1)
    first = _centre_points(frame, line, half_width)
    if np.isnan(first.light[-1]):
        return first  # the end is hidden, so the direction of an extension is unknown

    # Second pass from points a pixel apart, without the end, which may be cut
    # obliquely.
    read_count = max(len(first.points) - 1 - int(np.ceil(half_width)), 2)
    depth = first.depth[:read_count]
    count = max(round(depth[-1]) + 1, 2)
    even_depth = np.linspace(0, depth[-1], count)
    line = interpolate_rows(even_depth, depth, first.points[:read_count])
    # A straight extension would displace the tip of a bent string by up to 0.6 px.
    line = _extend_line(line, 2 * fit_length, 3 * half_width + 5, degree=2)
    return _centre_points(frame, line, half_width)


def _centre_points(
    frame: SegmentedFrame, line: np.ndarray, half_width: float
) -> Centreline:
    """Move a line (K, 2) [px] to the centroid of light, and cut it at the tip.

    The line has points a pixel apart and extends beyond the tip. Points within half a
    width of the tip keep the last measured shift.
    """
    tangent = unit_tangents(line)
    normal = turn_left(tangent)
    profile = _cross_profiles(frame, line, normal, half_width)
    end, end_sigma = _find_end(profile.near_light, profile.outlined, half_width)

    # Points before the tip, and the tip at a fraction of a pixel beyond the last one.
    last = int(end)
    count = last + 1
    read_count = max(count - int(np.ceil(half_width)), 1)
    smoothing = max(1.0, half_width / 3)
    shift = gaussian_filter1d(profile.shift[:read_count], smoothing, mode="nearest")
    shift = np.pad(shift, (0, count - read_count), mode="edge")
    points = line[:count] + shift[:, None] * normal[:count]
    tip = line[last] + (end % 1) * tangent[last] + shift[-1] * normal[last]

    number = np.append(np.arange(count), last)  # the tip has the profile before it
    sigma = point_sigmas(
        profile.sigma[number], profile.unseen[number], read_count, end_sigma
    )
    light = np.where(profile.outlined, np.nan, profile.light)
    return Centreline(np.vstack([points, tip]), sigma, light[number])


def _cross_profiles(
    frame: SegmentedFrame, line: np.ndarray, normal: np.ndarray, half_width: float
) -> CrossProfile:
    """Read profiles across a line (K, 2) [px] along its unit normals (K, 2)."""
    reach = max(MIN_PROFILE_REACH_PX, 1.8 * half_width + 2)
    across = np.arange(-reach, reach + 0.25, 0.5)  # (M,) [px]
    places = line[:, None] + across[None, :, None] * normal[:, None]  # (K, M, 2)
    u, v = np.moveaxis(places.astype(np.float32), -1, 0)
    light = cv2.remap(frame.light, u, v, cv2.INTER_LINEAR)
    outline = cv2.remap(frame.outline.astype(np.float32), u, v, cv2.INTER_LINEAR)

    bright = np.maximum(light - 2 * frame.noise, 0)
    total = bright.sum(axis=1)
    centroid = (bright * across).sum(axis=1) / np.maximum(total, 1e-9)
    shift = np.clip(centroid, -reach, reach)
    shift[0] = 0.0  # the beginning follows from the arm
    # This light is not cut at the noise, which would shorten a fading end.
    is_near = np.abs(across) <= 1.3 * half_width + 1
    near_light = light[:, is_near].sum(axis=1)

    is_dark = total < 4 * frame.noise
    on_string = np.abs(across) <= half_width + 1
    is_outlined = outline[:, on_string].max(axis=1) > 0.5
    # An outline is read at some distance from its edge.
    is_near_edge = distance_transform_edt(is_dark | is_outlined) < EXTENSION_PX
    is_unseen = is_dark | (is_outlined & is_near_edge)
    is_unseen[0] = False

    seen = np.flatnonzero(~is_unseen)
    shift = np.interp(np.arange(len(shift)), seen, shift[seen])
    sigma = centroid_sigma(
        bright, across, is_unseen, is_outlined, frame.noise, half_width
    )
    return CrossProfile(shift, sigma, total, near_light, is_outlined, is_unseen)


def _extend_line(
    line: np.ndarray, fit_length: float, extension: float, degree: int
) -> np.ndarray:
    """Extend a line by up to `extension` points, as far apart as its last ones.

    The extension is a polynomial of this degree through the last `fit_length` points.
    """
    end_points = line[-1 - int(fit_length) :]
    number = np.arange(1.0 - len(end_points), 1.0)  # 0 at the end of the line
    degree = min(degree, len(end_points) - 1)
    beyond = np.arange(1, extension)
    extended = []
    for coordinate in end_points.T:
        *coefficients, _ = np.polyfit(number, coordinate, degree)
        extended.append(coordinate[-1] + np.polyval([*coefficients, 0.0], beyond))
    return np.concatenate([line, np.stack(extended, axis=-1)])


def _find_end(
    light: np.ndarray, outlined: np.ndarray, half_width: float
) -> tuple[float, float]:
    """Find the point at which the light along a line falls to half, and its sigma.

    Motion blurs the end, but the half level lies at its place in the middle of the
    exposure, at any speed. An end hidden by an outline may lie anywhere in it. Both
    results are in numbers of points, which are pixels. Raises UnreadableError if no
    point is lit.
    """
    reach = int(4 * half_width + 4 + END_MARGIN_PX)
    first = max(len(light) - reach, 0)
    full_light = float(np.percentile(light[first:], 75))
    half_light = full_light / 2
    lit = np.flatnonzero(light >= half_light)
    if not lit.size:
        raise UnreadableError("no string in view")
    last = int(lit[-1])
    hidden_count = int(np.argmin(np.append(outlined[last + 1 :], False)))
    if hidden_count or last + 1 == len(light):
        # Mean and standard deviation of a uniform distribution over the hidden points.
        return last + hidden_count / 2, max(hidden_count, 1) / np.sqrt(12)

    drop = float(light[last] - light[last + 1])  # [grey levels half pixels] per point
    end = last + float(light[last] - half_light) / drop
    plateau = light[first : max(last - int(2 * half_width), first + 1)]
    light_sigma = mad_sigma(plateau - full_light)
    return end, float(np.hypot(END_SHAPE_SIGMA_PX, light_sigma / drop))
