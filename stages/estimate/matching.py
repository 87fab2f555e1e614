"""The matching rate E of IV-B: mass points against dilated images of the real string."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import pandas as pd
from numba import njit
from pydantic import Field

from stringcast.data.artifacts import Observation
from stringcast.stages.extract.score import pixel_scores, rasterise
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.model.engine.threads import parallel_for
from stringcast.stages.model.model import Model

# candidates that are worth a thread: each takes ten microseconds and more
CANDIDATES_PER_THREAD = 64
Count = Annotated[int, Field(ge=1, le=255)]


@dataclass(frozen=True)
class Matching:
    """Settings by which E is scored. dilations: p_max; step_px: growth of one dilation;
    tip_step_px: distance per score lost at the tip; delta_w: increase of the weight
    from point to point (Eq. 6).
    """

    dilations: Count
    step_px: Count
    tip_step_px: Annotated[float, Field(gt=0)]
    delta_w: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class MatchingTarget:
    """One trial's images as scores, its tips (F, 2) [px], and weights (F, n).

    scores: uint8, of each frame those near its string, row by row and frame after
    frame: a whole score map is nearly all zeros. windows: (F, 5), where a frame's begin
    in them, its first row and column, and its height and width [px].
    """

    trial: PreparedTrial
    matching: Matching
    scores: np.ndarray
    windows: np.ndarray
    tips: np.ndarray
    weights: np.ndarray

    def rates_by_frame(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """E_f of each candidate and frame, (C, F), NaN where a run was rejected, and
        who stayed finite (C,).
        """
        rates = np.full((len(values), len(self.windows)), np.nan)
        finite = np.zeros(len(values), dtype=bool)
        for some, motion in self.trial.simulate(values):
            pixels = self.trial.model.camera.pixels(motion.points)
            seen = (self.scores, self.windows, self.tips)
            found = frame_matching_rates(
                pixels,
                *seen,
                self.matching.tip_step_px,
                float(self.matching.dilations),
                self.weights,
            )
            rates[some] = np.where(motion.finite[:, None], found, np.nan)
            finite[some] = motion.finite
        return rates, finite


def matching_targets(
    model: Model, observations: Sequence[Observation], matching: Matching
) -> list[MatchingTarget]:
    """What each observation is compared with: its score maps, and weights of the mass
    points.
    """
    return [
        _matching_target(prepare_trial(model, o), o, matching) for o in observations
    ]


def matching_rate(goals: Sequence[MatchingTarget], values: np.ndarray) -> np.ndarray:
    """E of each candidate (C, P) over all frames of all trials, (C,); NaN where a run
    was rejected (Eq. 5).
    """
    return np.concatenate(
        [goal.rates_by_frame(values)[0] for goal in goals], axis=1
    ).mean(axis=1)


def frame_matching_rates(
    pixels: np.ndarray,
    scores: np.ndarray,
    windows: np.ndarray,
    tips: np.ndarray,
    tip_step: float,
    most: float,
    weights: np.ndarray,
) -> np.ndarray:
    """E_f = sum p_i w_i / (p_max sum w_i) of candidates (C, F, n, 2) [px], (C, F) (Eq.
    5).

    A point scores what `Target.scores` have at its pixel, 0 outside a frame's window;
    the tip scores p_max less one for each `tip_step` pixels from the real tip. weights:
    w_i in each frame, (F, n).
    """
    result = np.empty(pixels.shape[:2])
    given = (pixels, scores, windows, tips, tip_step, most, weights)
    parallel_for(
        lambda first, last: _match_candidates(*given, first, last, result),
        len(pixels),
        CANDIDATES_PER_THREAD,
    )
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _match_candidates(
    pixels: np.ndarray,
    scores: np.ndarray,
    windows: np.ndarray,
    tips: np.ndarray,
    tip_step: float,
    most: float,
    weights: np.ndarray,
    first: int,
    last: int,
    result: np.ndarray,
) -> None:
    """Some of the candidates. result: (C, F), filled in place."""
    frames, n = pixels.shape[1:3]
    for c in range(first, last):
        for f in range(frames):
            total = 0.0
            begin, top, left, height, width = windows[f]
            for i in range(n - 1):
                u = np.floor(pixels[c, f, i, 0] + 0.5) - left
                v = np.floor(pixels[c, f, i, 1] + 0.5) - top
                if 0 <= u < width and 0 <= v < height:
                    total += scores[begin + int(v) * width + int(u)] * weights[f, i]
            away = np.hypot(
                pixels[c, f, n - 1, 0] - tips[f, 0], pixels[c, f, n - 1, 1] - tips[f, 1]
            )
            total += max(most - np.floor(away / tip_step), 0.0) * weights[f, n - 1]
            result[c, f] = total / (most * weights[f].sum())


def _matching_target(
    ready: PreparedTrial, observation: Observation, matching: Matching
) -> MatchingTarget:
    """Scores from the binary images, or from the measured points where there are none;
    and the weights of Eq. 6.
    """
    images = (
        dict(zip(observation.masks["t"], observation.masks["png"], strict=True))
        if len(observation.masks)
        else {}
    )
    camera, string = ready.model.camera, ready.model.string
    near, tips = [], []
    for number, t in enumerate(ready.times):
        line = camera.pixels(ready.points[ready.frame == number])
        if t in images:
            mask = cv2.imdecode(
                np.frombuffer(images[t], np.uint8), cv2.IMREAD_GRAYSCALE
            )
            # the store has checked the table; its PNGs are ours
            assert mask is not None
        else:
            mask = rasterise(line, (camera.height, camera.width), 3)
        near.append(pixel_scores(mask, matching.dilations, matching.step_px))
        tips.append(line[np.argmax(ready.s[ready.frame == number])])
    begins = np.cumsum([0, *(part.size for _, _, part in near)])
    windows = np.array(
        [
            [begin, *at, *part.shape]
            for begin, (*at, part) in zip(begins, near, strict=False)
        ]
    )
    scores = np.concatenate([part.ravel() for _, _, part in near])

    # w_i = 1 + (i - 1) delta_w of the mass points that a frame shows, (F, n); 0 for
    # those it does not: where the tip is hidden, or only a marker was measured, nothing
    # is known of the rest
    s, half = string.arc_lengths(), string.segment_length / 2
    measured = pd.Series(np.clip(ready.s, 0, string.length)).groupby(ready.frame)
    first, last = measured.min().to_numpy()[:, None], measured.max().to_numpy()[:, None]
    shown = (s >= first - half) & (s <= last + half)
    weights = np.where(shown, 1 + np.arange(len(s)) * matching.delta_w, 0.0)
    return MatchingTarget(ready, matching, scores, windows, np.array(tips), weights)
