"""Sightings of the arm's outline in frames, across each link.

The arm consists of pixels that differ from the scene, in areas wider than a string.
Each pixel belongs to the nearest link of the model. A sighting is the mean offset of
pixels across a piece of a link. The search starts with few frames and distant pixels,
and ends with all frames and pixels within the link's own width.

References
----------
Chen and Medioni, "Object modelling by registration of multiple range images", 1992
(iterated closest points, point to line).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stringcast.data.artifacts import JOINTS, Film
from stringcast.data.lazy_module import LazyModule
from stringcast.data.schema import DataError
from stringcast.stages.align.fit import (
    REQUIRED_EFFECTS,
    AlignmentProblem,
    fit_alignment,
)
from stringcast.stages.align.sightings import SightedTrial, Sightings
from stringcast.stages.common import Progress, choose_evenly
from stringcast.stages.extract.segment import uncovered_brightness
from stringcast.stages.extract.stabilise import MAX_SAMPLES
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from stringcast.stages.model.model import Model
from stringcast.stages.model.polyline import turn_left

cv2 = LazyModule("cv2")

PIECES_PER_LINK = 6  # each piece is a sighting
# share of a link at either end that is not used, because links and gripper overlap
LINK_END_SHARE = 0.15
OPENING_SHARE = 0.5  # of the arm's width; narrower objects are not the arm
MIN_CONTRAST = 25.0  # grey levels between arm and scene
COARSE_FRAMES = 60  # of a trial, at the start of the search
MAX_FRAMES = 500  # of a trial
# arm widths within which pixels count, in each round of the search
SEARCH_WIDTHS = (6.0, 3.0, 1.5, 1.0)
FINAL_WIDTHS = 1.0
# smallest distance of other links from a piece's edges, in arm widths
MIN_CLEARANCE_WIDTHS = 0.8
# pixels over the median of the link's pieces; others are partly hidden or overlapped
PIXEL_RATIO_RANGE = (0.85, 1.15)
EDGE_SIGMA_PX = 0.1  # standard deviation of a sighting


@dataclass(frozen=True)
class Silhouettes:
    """The arm in some frames of a trial.

    Attributes
    ----------
    name
        The trial.
    motion
        Motion of the joints.
    times
        Times of the frames (F,) [s].
    pixels
        Pixels of the arm in each frame (n, 2).
    """

    name: str
    motion: JointMotion
    times: np.ndarray
    pixels: Sequence[np.ndarray]


def sightings_from_films(
    model: Model, films: Mapping[str, Film], width: float, progress: Progress
) -> list[SightedTrial]:
    """Read the arm's outline in films with joint angles.

    width: of the links [m]. Raises DataError if no arm is seen.
    """
    # an odd size does not shift the outline
    opening = round(width * model.camera.px_per_m * OPENING_SHARE) // 2 * 2 + 1
    silhouettes = []
    for name, film in films.items():
        silhouettes.append(extract_silhouettes(name, film, opening))
        progress(len(silhouettes) / len(films))

    values = model.values({})
    for reach in SEARCH_WIDTHS:
        trials = []
        for trial in silhouettes:
            step = max(len(trial.times) // COARSE_FRAMES, 1)
            frames = np.arange(0, len(trial.times), step)
            pieces = find_pieces(model, values, trial, frames, width, reach)
            trials.append(build_sighted_trial(trial, frames, pieces, width / 4))
        if not any(len(trial.sightings.frame) for trial in trials):
            raise DataError(
                "",
                "no outline of the arm is near the links of the joint angles",
                "Correct camera.px_per_m and camera.origin_px, and align.arm_width.",
            )
        problem = AlignmentProblem(model, tuple(trials))
        values = model.values(fit_alignment(problem, REQUIRED_EFFECTS).values)

    sigma = EDGE_SIGMA_PX / model.camera.px_per_m
    trials = []
    for trial in silhouettes:
        frames = np.arange(len(trial.times))
        pieces = find_pieces(model, values, trial, frames, width, FINAL_WIDTHS)
        visible = drop_hidden_pieces(pieces)
        trials.append(build_sighted_trial(trial, frames, visible, sigma))
    return trials


def extract_silhouettes(name: str, film: Film, opening: int) -> Silhouettes:
    """Extract pixels of wide objects that differ from the scene, in some frames.

    opening: width below which objects are not the arm [px]. Raises DataError if the
    contrast is too small.
    """
    assert film.arm is not None
    log_t, log = film.arm["t"].to_numpy(), film.arm[list(JOINTS)].to_numpy()
    motion = resample_joint_motion(log_t, log).extended_until(film.t[-1])
    chosen = choose_evenly(len(film.t), MAX_FRAMES)
    scene_frames = choose_evenly(len(film.images), MAX_SAMPLES)
    scene = estimate_scene(np.stack([film.images[number] for number in scene_frames]))

    def difference(number: int) -> np.ndarray:
        image = film.images[number].astype(np.float32)
        return cv2.absdiff(image, scene)

    # contrast of the arm: the upper of two classes of differences (Otsu)
    coarse = chosen[:: max(len(chosen) // COARSE_FRAMES, 1)]
    differences = np.stack([difference(number) for number in coarse])
    levels = np.clip(differences, 0, 255).astype(np.uint8).reshape(1, -1)
    limit, _ = cv2.threshold(levels, 0, 255, cv2.THRESH_OTSU)
    upper = differences[differences > limit]
    contrast = float(np.median(upper)) if len(upper) else 0.0
    if contrast < MIN_CONTRAST:
        raise DataError(
            "",
            f"the arm differs from the scene by only {contrast:.0f} grey levels",
            "Give it more light, or another colour than the background.",
        )

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (opening, opening))
    pixels = []
    for number in chosen:
        mask = (difference(number) > contrast / 2).astype(np.uint8)
        rows, columns = np.nonzero(cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc))
        pixels.append(np.stack([columns, rows], axis=-1).astype(float))
    return Silhouettes(name, motion, film.t[chosen], pixels)


def estimate_scene(frames: np.ndarray) -> np.ndarray:
    """Estimate the scene (height, width) behind an arm that is brighter or darker.

    It is the one of two estimates from which the frames (F, height, width) differ less,
    because the arm covers only a small part of each frame.
    """

    def mean_difference(scene: np.ndarray) -> float:
        frame_means = [
            cv2.absdiff(frame.astype(np.float32), scene).mean() for frame in frames
        ]
        return float(np.mean(frame_means))

    behind_bright_arm = uncovered_brightness(list(frames))
    behind_dark_arm = 255 - uncovered_brightness(list(255 - frames))
    return min(behind_bright_arm, behind_dark_arm, key=mean_difference)


def find_pieces(
    model: Model,
    values: np.ndarray,
    trial: Silhouettes,
    frames: np.ndarray,
    width: float,
    reach: float,
) -> pd.DataFrame:
    """Find pieces of links in some frames of a trial, as in `link_pieces`.

    values: of the model that gives the expected arm. frames: their indices. width: of
    the links [m]. reach: arm widths within which pixels count. Returns a table with
    column `position`, the index in `frames`.
    """
    times = trial.times[frames]
    joints_by_frame = model.observed_arm(trial.motion, values[None], times)[0]
    tables = []
    for position, joints in enumerate(joints_by_frame):
        pixels = trial.pixels[int(frames[position])]
        pieces = link_pieces(model, pixels, joints, width, reach)
        tables.append(pieces.assign(position=position))
    return pd.concat(tables, ignore_index=True)


def build_sighted_trial(
    trial: Silhouettes, frames: np.ndarray, pieces: pd.DataFrame, sigma: float
) -> SightedTrial:
    """Build the sightings of pieces in some frames, with sigma [m]."""
    sightings = Sightings(
        trial.times[frames],
        frame=pieces["position"].to_numpy(),
        link=pieces["link"].to_numpy(),
        share=pieces["share"].to_numpy(),
        position=pieces[["x", "y"]].to_numpy(),
        direction=pieces[["normal_x", "normal_y"]].to_numpy(),
        sigma=np.full(len(pieces), sigma),
    )
    return SightedTrial(trial.name, trial.motion, sightings)


def link_pieces(
    model: Model, pixels: np.ndarray, joints: np.ndarray, width: float, reach: float
) -> pd.DataFrame:
    """Locate the middle of each piece of each link.

    pixels: of the arm (n, 2). joints: expected positions (J + 1, 2) [m]. width, reach:
    as in `find_pieces`.

    Returns
    -------
    DataFrame
        A row for each piece: number of its link from 1, position of its middle as a
        share of the link, the middle x, y [m], the unit vector normal_x, normal_y
        across the link, and the number of its pixels.
    """
    points = model.camera.world(pixels)
    number, share, offset = _assign_to_pieces(points, joints, reach * width)

    # means over the pixels of each piece
    count = np.bincount(number, minlength=PIECES_PER_LINK * (len(joints) - 1))
    pieces = np.flatnonzero(count)
    pixel_count = count[pieces]
    mean_offset = np.bincount(number, offset, len(count))[pieces] / pixel_count
    mean_share = np.bincount(number, share, len(count))[pieces] / pixel_count
    link = pieces // PIECES_PER_LINK
    vector = joints[link + 1] - joints[link]
    lengths = np.linalg.norm(vector, axis=1, keepdims=True)
    normal = turn_left(vector) / lengths
    axis = joints[link] + mean_share[:, None] * vector
    middle = axis + mean_offset[:, None] * normal
    columns = {
        "link": link + 1,
        "share": mean_share,
        "x": middle[:, 0],
        "y": middle[:, 1],
        "normal_x": normal[:, 0],
        "normal_y": normal[:, 1],
        "pixels": pixel_count,
    }
    is_clear = np.ones(len(axis), bool)
    for side in (-width / 2, width / 2):
        is_clear &= _is_clear_of_others(axis + side * normal, link, joints, width)
    return pd.DataFrame(columns)[is_clear]


def _assign_to_pieces(
    points: np.ndarray, joints: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Assign points (n, 2) [m] to the pieces of the nearest link within reach [m].

    Returns
    -------
    number
        Number of the piece of each used point, from the base (m,).
    share, offset
        Coordinates along and across the link (m,), as in `link_coordinates`.
    """
    shares, offsets, distances = link_coordinates(points, joints)  # (n, J) each
    nearest = np.argmin(distances, axis=1)
    at_nearest = (np.arange(len(points)), nearest)
    share, offset = shares[at_nearest], offsets[at_nearest]
    is_on_link = (share > LINK_END_SHARE) & (share < 1 - LINK_END_SHARE)
    is_used = is_on_link & (distances[at_nearest] < reach)
    share, offset = share[is_used], offset[is_used]
    position = (share - LINK_END_SHARE) / (1 - 2 * LINK_END_SHARE) * PIECES_PER_LINK
    number = nearest[is_used] * PIECES_PER_LINK + position.astype(int)
    return number, share, offset


def _is_clear_of_others(
    edge: np.ndarray, link: np.ndarray, joints: np.ndarray, width: float
) -> np.ndarray:
    """Return whether edges (n, 2) [m] of pieces are clear of other links, (n,).

    A link nearby would hide or widen the piece. link: link of each piece, from 0 (n,).
    """
    _, _, to_links = link_coordinates(edge, joints)
    to_links[np.arange(len(edge)), link] = np.inf
    return to_links.min(axis=1) > MIN_CLEARANCE_WIDTHS * width


def link_coordinates(
    points: np.ndarray, joints: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coordinates of points (n, 2) [m] relative to each link.

    joints: positions (J + 1, 2) [m].

    Returns
    -------
    share
        Position along the link, as a share (n, J).
    offset
        Distance to the left of the link's line (n, J) [m].
    distance
        Distance from the link (n, J) [m].
    """
    vector = np.diff(joints, axis=0)
    length = np.linalg.norm(vector, axis=1)
    normal = turn_left(vector) / length[:, None]
    from_start = points[:, None] - joints[None, :-1]
    share = np.einsum("nji,ji->nj", from_start, vector) / length**2
    offset = np.einsum("nji,ji->nj", from_start, normal)
    beyond_ends = np.maximum(np.maximum(-share, share - 1), 0) * length
    return share, offset, np.hypot(offset, beyond_ends)


def drop_hidden_pieces(pieces: pd.DataFrame) -> pd.DataFrame:
    """Drop pieces that are partly hidden or overlap other objects."""
    usual = pieces.groupby("link")["pixels"].transform("median")
    low, high = PIXEL_RATIO_RANGE
    is_whole = pieces["pixels"].between(low * usual, high * usual, inclusive="neither")
    return pieces[is_whole]
