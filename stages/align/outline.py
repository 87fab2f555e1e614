"""The arm's outline in frames: where the middle of each link is seen, across the link.

The arm is what differs from the scene and is wider than any string. Its pixels belong to the link that the model has
nearest; what they are off on average, across it, is what is seen (iterated closest points, point to line: Chen and
Medioni 1992). It begins with few frames and far off, and ends with all and within the link's own width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from data.artifacts import JOINTS, Film
from data.schema import DataError
from stages.align.fit import ALWAYS, Problem, fitted
from stages.align.sightings import Sighted, Sightings, arm_seen
from stages.extract.isolate import background
from stages.model.hand import joint_motion
from stages.model.model import Model

BINS = 12  # pieces of a link, each a sighting
ENDS = 0.15  # share of a link at its ends that is left out: there links and gripper overlap
OPENING = 0.5  # of the arm's width: what is narrower is not arm
FAINT = 25.0  # [grey levels] an arm that differs less from the scene is not seen
COARSE = 60  # frames of a trial with which it begins
MOST = 500  # frames of a trial that are looked at
REACHES = (6.0, 3.0, 1.5, 1.0, 1.0)  # arm widths within which pixels count, one round after the other
CLEAR = 1.0  # arm widths that the next link must be away
WHOLE = (0.7, 1.3)  # times the usual number of pixels: a piece with others is hidden, or hides something
SHARP = 0.15  # [px] one standard deviation of a sighting


@dataclass(frozen=True)
class Silhouettes:
    """The arm in some frames of a trial. times: (F,) [s]. pixels: for each frame (n, 2) the pixels that are arm."""

    name: str
    film: Film
    times: np.ndarray
    pixels: Sequence[np.ndarray]


def from_films(model: Model, films: dict[str, Film], width: float) -> tuple[Sighted, ...]:
    """Trials as their films show them. model: with every effect that is looked for. width: of the links [m].

    Raises DataError where no arm is seen.
    """
    seen = [silhouettes(name, film, max(round(width * model.camera.px_per_m * OPENING), 2)) for name, film in films.items()]
    known = model.values({})
    for number, reach in enumerate(REACHES):
        last = number == len(REACHES) - 1
        trials = tuple(sighted(model, known, one, width, reach, last) for one in seen)
        if not sum(len(trial.sightings.frame) for trial in trials):
            raise DataError(
                "the arm's outline is nowhere where the joints say that it is. Correct camera.px_per_m and "
                "camera.origin_px, and align.arm_width."
            )
        if not last:
            known = model.values(fitted(Problem(model, trials), ALWAYS).values)
    return trials


def silhouettes(name: str, film: Film, opening: int) -> Silhouettes:
    """What of each frame is arm: differs from the scene and is wider than `opening` [px]."""
    chosen = np.unique(np.linspace(0, len(film.t) - 1, MOST).astype(int))
    scene = background(film.images)
    level = contrast(film, chosen[:: max(len(chosen) // COARSE, 1)], scene) / 2
    round_ = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (opening, opening))
    pixels = []
    for number in chosen:
        mask = (cv2.absdiff(film.images[int(number)].astype(np.float32), scene) > level).astype(np.uint8)
        rows, columns = np.nonzero(cv2.morphologyEx(mask, cv2.MORPH_OPEN, round_))
        pixels.append(np.stack([columns, rows], axis=-1).astype(float))
    return Silhouettes(name, film, film.t[chosen], pixels)


def contrast(film: Film, chosen: np.ndarray, scene: np.ndarray) -> float:
    """How much the arm differs from the scene [grey levels]: the upper of the two classes of what differs (Otsu)."""
    off = np.stack([cv2.absdiff(film.images[int(n)].astype(np.float32), scene) for n in chosen])
    level, _ = cv2.threshold(np.clip(off, 0, 255).astype(np.uint8).reshape(1, -1), 0, 255, cv2.THRESH_OTSU)
    size = float(np.median(off[off > level])) if (off > level).any() else 0.0
    if size < FAINT:
        raise DataError(
            f"the arm differs from the scene by {size:.0f} grey levels only: it cannot be seen. Give it more light, or "
            "another colour than the background."
        )
    return size


def sighted(
    model: Model, known: np.ndarray, seen: Silhouettes, width: float, reach: float, last: bool
) -> Sighted:
    """A trial, its pixels given to the links where the parameters `known` (P,) have them. last: of all frames, and of
    whole pieces only. reach: in arm widths."""
    motion = joint_motion(seen.film.arm["t"].to_numpy(), seen.film.arm[list(JOINTS)].to_numpy())
    some = np.arange(0, len(seen.times), 1 if last else max(len(seen.times) // COARSE, 1))
    there = arm_seen(model, motion, known[None], seen.times[some])[0]
    parts = [pieces(model, seen.pixels[i], joints, width, reach) for i, joints in zip(some, there, strict=True)]
    table = np.concatenate([np.column_stack([np.full(len(p), n), p]) for n, p in enumerate(parts)])
    if last and len(table):
        table = whole(table)
    sigma = SHARP / model.camera.px_per_m if last else width / 4
    frame, link, share, x, y, along_x, along_y, _ = table.T
    where = (frame.astype(int), link.astype(int), share, np.stack([x, y], axis=-1))
    along = np.stack([along_x, along_y], axis=-1)
    return Sighted(seen.name, motion, Sightings(seen.times[some], *where, along, np.full(len(table), sigma)))


def pieces(model: Model, pixels: np.ndarray, joints: np.ndarray, width: float, reach: float) -> np.ndarray:
    """Where the middle of each piece of each link is seen: link, share, x, y, the normal, and how many pixels, (K, 8).

    pixels: (n, 2). joints: (J + 1, 2) where they are looked for [m].
    """
    points = model.camera.world(pixels)
    way = np.diff(joints, axis=0)
    length = np.linalg.norm(way, axis=1)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) / length[:, None]
    from_base = points[:, None] - joints[None, :-1]
    share = np.einsum("nji,ji->nj", from_base, way) / length**2
    across = np.einsum("nji,ji->nj", from_base, normal)
    beyond = np.maximum(np.maximum(-share, share - 1), 0) * length
    distance = np.hypot(across, beyond)
    order = np.sort(distance, axis=1)
    nearest = np.argmin(distance, axis=1)
    own = (np.arange(len(points)), nearest)
    good = (order[:, 0] < reach * width) & (order[:, 1] > order[:, 0] + CLEAR * width)
    good &= (share[own] > ENDS) & (share[own] < 1 - ENDS)
    bin_ = ((share[own] - ENDS) / (1 - 2 * ENDS) * BINS).astype(int)
    number = nearest[good] * BINS + bin_[good]
    count = np.bincount(number, minlength=len(length) * BINS)
    there = np.flatnonzero(count)
    off, at = (np.bincount(number, v[own][good], len(count))[there] / count[there] for v in (across, share))
    link = there // BINS
    middle = joints[link] + at[:, None] * way[link] + off[:, None] * normal[link]
    return np.column_stack([link + 1, at, middle, normal[link], count[there]])


def whole(table: np.ndarray) -> np.ndarray:
    """Without pieces of a link that are hidden in part, or in which something else is seen. table: (K, 9)."""
    kept = np.zeros(len(table), bool)
    for link in np.unique(table[:, 1]):
        own = table[:, 1] == link
        usual = np.median(table[own, -1])
        kept |= own & (table[:, -1] > WHOLE[0] * usual) & (table[:, -1] < WHOLE[1] * usual)
    return table[kept]
