"""The arm's outline in frames: where the middle of each link is seen, across the link.

The arm is what differs from the scene and is wider than any string. Its pixels belong
to the link that the model has nearest; what they are off on average, across it, is what
is seen (iterated closest points, point to line: Chen and Medioni 1992). It begins with
few frames and far off, and ends with all and within the link's own width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stringcast.data.artifacts import JOINTS, Film
from stringcast.data.schema import DataError
from stringcast.stages.align.fit import (
    REQUIRED_EFFECTS,
    AlignmentProblem,
    fit_alignment,
)
from stringcast.stages.align.sightings import SightedTrial, Sightings
from stringcast.stages.common import Progress
from stringcast.stages.extract.segment import uncovered_brightness
from stringcast.stages.extract.stabilise import sample_numbers
from stringcast.stages.model.hand import JointMotion, resample_joint_motion
from stringcast.stages.model.model import Model

PIECES_PER_LINK = 6  # pieces of a link, each a sighting
# share of a link at its ends that is left out: there links and gripper overlap
LINK_END_SHARE = 0.15
OPENING_SHARE = 0.5  # of the arm's width: what is narrower is not arm
MIN_CONTRAST = 25.0  # [grey levels] an arm that differs less from the scene is not seen
COARSE_FRAMES = 60  # frames of a trial with which it begins
MAX_FRAMES = 500  # frames of a trial that are looked at
# arm widths within which pixels count, one round after the other
SEARCH_WIDTHS = (6.0, 3.0, 1.5, 1.0)
MAX_DISTANCE_WIDTHS = 1.0  # the same at the end
# arm widths that the middle of another link must be away from a piece's edges
MIN_VISIBLE_SHARE = 0.8
# times the usual number of pixels: a piece with others is hidden, or hides something
WIDTH_RATIO_RANGE = (0.85, 1.15)
EDGE_SIGMA_PX = 0.1  # [px] one standard deviation of a sighting


@dataclass(frozen=True)
class Silhouettes:
    """The arm in some frames of a trial. times: (F,) [s]. pixels: for each frame (n, 2)
    the pixels that are arm.
    """

    name: str
    motion: JointMotion
    times: np.ndarray
    pixels: Sequence[np.ndarray]


def sightings_from_films(
    model: Model, films: Mapping[str, Film], width: float, progress: Progress
) -> tuple[SightedTrial, ...]:
    """Trials as their films show them. model: with every effect that is looked for.
    width: of the links [m].

    Raises DataError where no arm is seen.
    """
    # an even one would shift what it leaves
    opening = round(width * model.camera.px_per_m * OPENING_SHARE) // 2 * 2 + 1
    seen = []
    for name, film in films.items():
        seen.append(extract_silhouettes(name, film, opening))
        progress(len(seen) / len(films))
    known = model.values({})
    for reach in SEARCH_WIDTHS:
        trials = []
        for one in seen:  # some frames of each
            some = np.arange(0, len(one.times), max(len(one.times) // COARSE_FRAMES, 1))
            trials.append(
                build_sighted_trial(
                    one,
                    some,
                    find_pieces(model, known, one, some, width, reach),
                    width / 4,
                )
            )
        if not sum(len(trial.sightings.frame) for trial in trials):
            raise DataError(
                "the arm's outline is nowhere where the joints say that it is. Correct camera.px_per_m and "
                "camera.origin_px, and align.arm_width."
            )
        known = model.values(
            fit_alignment(
                AlignmentProblem(model, tuple(trials)), REQUIRED_EFFECTS
            ).values
        )
    found = []
    for one in seen:  # all frames, and of these the pieces of links that are seen whole
        every = np.arange(len(one.times))
        table = drop_hidden_pieces(
            find_pieces(model, known, one, every, width, MAX_DISTANCE_WIDTHS)
        )
        found.append(
            build_sighted_trial(
                one, every, table, EDGE_SIGMA_PX / model.camera.px_per_m
            )
        )
    return tuple(found)


def extract_silhouettes(name: str, film: Film, opening: int) -> Silhouettes:
    """Pixels of the arm in each frame: those that differ from the scene and are wider
    than `opening` [px]. film: one with joints.
    """
    assert film.arm is not None
    motion = resample_joint_motion(
        film.arm["t"].to_numpy(), film.arm[list(JOINTS)].to_numpy()
    ).extended_until(film.t[-1])
    chosen = np.unique(np.linspace(0, len(film.t) - 1, MAX_FRAMES).astype(int))
    scene = estimate_scene(
        np.stack([film.images[i] for i in sample_numbers(len(film.images))])
    )

    # contrast of the arm with the scene [grey levels]: the upper of the two classes of
    # what differs (Otsu)
    few = chosen[:: max(len(chosen) // COARSE_FRAMES, 1)]
    off = np.stack(
        [cv2.absdiff(film.images[int(n)].astype(np.float32), scene) for n in few]
    )
    limit, _ = cv2.threshold(
        np.clip(off, 0, 255).astype(np.uint8).reshape(1, -1), 0, 255, cv2.THRESH_OTSU
    )
    contrast = float(np.median(off[off > limit])) if (off > limit).any() else 0.0
    if contrast < MIN_CONTRAST:
        raise DataError(
            f"the arm differs from the scene by {contrast:.0f} grey levels only: it cannot be seen. Give it more "
            "light, or another colour than the background."
        )

    round_ = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (opening, opening))
    pixels = []
    for number in chosen:
        mask = (
            cv2.absdiff(film.images[int(number)].astype(np.float32), scene)
            > contrast / 2
        ).astype(np.uint8)
        rows, columns = np.nonzero(cv2.morphologyEx(mask, cv2.MORPH_OPEN, round_))
        pixels.append(np.stack([columns, rows], axis=-1).astype(float))
    return Silhouettes(name, motion, film.t[chosen], pixels)


def estimate_scene(stack: np.ndarray) -> np.ndarray:
    """The scene, (height, width) float32, before which an arm moves that is brighter or
    darker. stack: (F, h, w) uint8.

    An arm is in few places of its swing at a time: taken for scene, it would differ
    from more of what is seen.
    """

    def off(scene: np.ndarray) -> float:
        return float(
            np.mean(
                [cv2.absdiff(frame.astype(np.float32), scene).mean() for frame in stack]
            )
        )

    return min(
        uncovered_brightness(list(stack)),
        255 - uncovered_brightness(list(255 - stack)),
        key=off,
    )


def find_pieces(
    model: Model,
    known: np.ndarray,
    seen: Silhouettes,
    some: np.ndarray,
    width: float,
    reach: float,
) -> np.ndarray:
    """The table of `pieces` in some frames, with the frame's number as first column,
    (K, 9).
    """
    there = model.observed_arm(seen.motion, known[None], seen.times[some])[0]
    parts = [
        link_pieces(model, seen.pixels[int(i)], joints, width, reach)
        for i, joints in zip(some, there, strict=True)
    ]
    return np.concatenate(
        [np.column_stack([np.full(len(p), n), p]) for n, p in enumerate(parts)]
    )


def build_sighted_trial(
    seen: Silhouettes, some: np.ndarray, table: np.ndarray, sigma: float
) -> SightedTrial:
    """The trial with what was seen in some of its frames. table: (K, 9) of
    `looked_for`. sigma: [m].
    """
    frame, link, share, x, y, along_x, along_y, _ = table.T
    where = (frame.astype(int), link.astype(int), share, np.stack([x, y], axis=-1))
    along = np.stack([along_x, along_y], axis=-1)
    return SightedTrial(
        seen.name,
        seen.motion,
        Sightings(seen.times[some], *where, along, np.full(len(table), sigma)),
    )


def link_pieces(
    model: Model, pixels: np.ndarray, joints: np.ndarray, width: float, reach: float
) -> np.ndarray:
    """The middle of each piece of each link as it is seen: link, share, x, y, the
    normal, and how many pixels, (K, 8).

    pixels: (n, 2). joints: (J + 1, 2) where they are looked for [m].
    """
    points = model.camera.world(pixels)
    share, across, distance = link_coordinates(points, joints)
    nearest = np.argmin(distance, axis=1)
    own = (np.arange(len(points)), nearest)
    good = (
        (distance[own] < reach * width)
        & (share[own] > LINK_END_SHARE)
        & (share[own] < 1 - LINK_END_SHARE)
    )
    piece = (
        (share[own] - LINK_END_SHARE) / (1 - 2 * LINK_END_SHARE) * PIECES_PER_LINK
    ).astype(int)
    number = (nearest * PIECES_PER_LINK + piece)[good]
    count = np.bincount(number, minlength=PIECES_PER_LINK * (len(joints) - 1))
    there = np.flatnonzero(count)
    off, at = (
        np.bincount(number, v[own][good], len(count))[there] / count[there]
        for v in (across, share)
    )
    link = there // PIECES_PER_LINK
    way = joints[link + 1] - joints[link]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) / np.linalg.norm(
        way, axis=1, keepdims=True
    )
    axis = joints[link] + at[:, None] * way
    # other links must be clear of both edges of a piece, so that neither side is cut or
    # added to
    near = np.full(len(axis), np.inf)
    for side in (-width / 2, width / 2):
        others = link_coordinates(axis + side * normal, joints)[2]
        others[np.arange(len(axis)), link] = np.inf
        near = np.minimum(near, others.min(axis=1))
    clear = near > MIN_VISIBLE_SHARE * width
    return np.column_stack(
        [link + 1, at, axis + off[:, None] * normal, normal, count[there]]
    )[clear]


def link_coordinates(
    points: np.ndarray, joints: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share along each link, distance from its line to its left and from itself [m],
    (n, J) each. points: (n, 2).
    """
    way = np.diff(joints, axis=0)
    length = np.linalg.norm(way, axis=1)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) / length[:, None]
    from_start = points[:, None] - joints[None, :-1]
    share = np.einsum("nji,ji->nj", from_start, way) / length**2
    across = np.einsum("nji,ji->nj", from_start, normal)
    return (
        share,
        across,
        np.hypot(across, np.maximum(np.maximum(-share, share - 1), 0) * length),
    )


def drop_hidden_pieces(table: np.ndarray) -> np.ndarray:
    """Without pieces of a link that are hidden in part, or in which something else is
    seen. table: (K, 9).
    """
    kept = np.zeros(len(table), bool)
    for link in np.unique(table[:, 1]):
        own = table[:, 1] == link
        usual = np.median(table[own, -1])
        kept |= (
            own
            & (table[:, -1] > WIDTH_RATIO_RANGE[0] * usual)
            & (table[:, -1] < WIDTH_RATIO_RANGE[1] * usual)
        )
    return table[kept]
