"""Compute the matching rate E of mass points with dilated images (IV-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeFloat, PositiveFloat

from stringcast.data.artifacts import Observation
from stringcast.data.lazy_module import LazyModule
from stringcast.stages.extract.score import pixel_scores, rasterise
from stringcast.stages.inference.prepared_trial import PreparedTrial, prepare_trial
from stringcast.stages.model.engine.simulate import StringMotion
from stringcast.stages.model.engine.threads import compile_kernel, parallel_for
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import parameter_values

cv2 = LazyModule("cv2")

CANDIDATES_PER_THREAD = 64  # at least; each takes at least ten microseconds
LINE_WIDTH_PX = 3  # of the measured centre-line, in frames without an image
Count = Annotated[int, Field(ge=1, le=255)]


@dataclass(frozen=True)
class Matching:
    """Settings of the matching rate.

    Parameters
    ----------
    dilations
        Number of dilations p_max.
    step_px
        Growth by one dilation [px].
    tip_step_px
        Distance from the tip that lowers the score by one [px].
    delta_w
        Increase of the weight from point to point (Eq. 6).
    """

    dilations: Count
    step_px: Count
    tip_step_px: PositiveFloat
    delta_w: NonNegativeFloat


@dataclass(frozen=True)
class MatchingTarget:
    """Images and points of a trial, prepared for the comparison with simulated strings.

    Parameters
    ----------
    trial
        Motion and measured points.
    matching
        Settings of the score.
    scores
        Scores of the pixels near the string, uint8, row by row and frame by frame; all
        other scores are zero.
    windows
        Window of each frame: index of its first score, first row and column, height
        and width [px], (F, 5).
    tips
        Positions of the tip, (F, 2) [px].
    weights
        Weights of the mass points in each frame, (F, n).
    """

    trial: PreparedTrial
    matching: Matching
    scores: np.ndarray
    windows: np.ndarray
    tips: np.ndarray
    weights: np.ndarray

    def rates_by_frame(self, values: np.ndarray) -> np.ndarray:
        """Compute E_f of candidates (C, P), (C, F); NaN where one diverged."""
        rates = np.full((len(values), len(self.windows)), np.nan)
        for chunk, motion in self.trial.simulate(values):
            rates[chunk] = self.rates_of_motion(motion)
        return rates

    def rates_of_motion(self, motion: StringMotion) -> np.ndarray:
        """Compute E_f of C simulated strings, (C, F); NaN where one diverged."""
        rates = frame_matching_rates(
            self.trial.model.camera.pixels(motion.points),
            self.scores,
            self.windows,
            self.tips,
            self.matching.tip_step_px,
            float(self.matching.dilations),
            self.weights,
        )
        return np.where(motion.finite[:, None], rates, np.nan)


def matching_targets(
    model: Model, observations: Sequence[Observation], matching: Matching
) -> list[MatchingTarget]:
    """Prepare each observation for the matching rate."""
    targets = []
    for observation in observations:
        trial = prepare_trial(model, observation)
        targets.append(_matching_target(trial, observation, matching))
    return targets


def matching_rate(targets: Sequence[MatchingTarget], chi: np.ndarray) -> np.ndarray:
    """Compute E of candidates over all frames of all trials (Eq. 5).

    Parameters
    ----------
    chi
        Exponents, (C, P).

    Returns
    -------
    E, (C,); NaN where the simulation diverged.
    """
    values = parameter_values(targets[0].trial.model.parameters, chi)
    rates = [target.rates_by_frame(values) for target in targets]
    return np.concatenate(rates, axis=1).mean(axis=1)


def frame_matching_rates(
    pixels: np.ndarray,
    scores: np.ndarray,
    windows: np.ndarray,
    tips: np.ndarray,
    tip_step: float,
    max_score: float,
    weights: np.ndarray,
) -> np.ndarray:
    """Compute E_f = sum p_i w_i / (p_max sum w_i) of candidates, (C, F) (Eq. 5).

    The score of a point is that of its pixel, 0 outside a frame's window. The score of
    the tip is p_max minus one for each `tip_step` pixels from the measured tip.

    Parameters
    ----------
    pixels
        Mass points, (C, F, n, 2) [px].
    scores, windows, tips, weights
        As in `MatchingTarget`.
    tip_step
        Distance that lowers the tip's score by one [px].
    max_score
        The highest score p_max.
    """
    result = np.empty(pixels.shape[:2])

    def match(first: int, last: int) -> None:
        chosen = slice(first, last)
        _match_candidates(
            pixels[chosen],
            scores,
            windows,
            tips,
            tip_step,
            max_score,
            weights,
            result[chosen],
        )

    parallel_for(match, len(pixels), CANDIDATES_PER_THREAD)
    return result


@compile_kernel
def _match_candidates(
    pixels: np.ndarray,
    scores: np.ndarray,
    windows: np.ndarray,
    tips: np.ndarray,
    tip_step: float,
    max_score: float,
    weights: np.ndarray,
    result: np.ndarray,
) -> None:
    """Fill the result (C, F) of `frame_matching_rates`."""
    candidates, frames, n = pixels.shape[:3]
    for c in range(candidates):
        for f in range(frames):
            total = 0.0
            begin, top, left, height, width = windows[f]
            for i in range(n - 1):
                u = np.floor(pixels[c, f, i, 0] + 0.5) - left
                v = np.floor(pixels[c, f, i, 1] + 0.5) - top
                if 0 <= u < width and 0 <= v < height:
                    total += scores[begin + int(v) * width + int(u)] * weights[f, i]
            off_u = pixels[c, f, n - 1, 0] - tips[f, 0]
            off_v = pixels[c, f, n - 1, 1] - tips[f, 1]
            lost = np.floor(np.hypot(off_u, off_v) / tip_step)
            total += max(max_score - lost, 0.0) * weights[f, n - 1]
            result[c, f] = total / (max_score * weights[f].sum())


def _matching_target(
    trial: PreparedTrial, observation: Observation, matching: Matching
) -> MatchingTarget:
    """Compute scores of images, or of measured points without image, and weights."""
    masks = observation.masks
    images = dict(zip(masks["t"], masks["png"], strict=True))
    camera = trial.model.camera
    begin = 0
    scores, windows, tips = [], [], []
    for number, t in enumerate(trial.times):
        in_frame = trial.frame == number
        line = camera.pixels(trial.points[in_frame])
        if t in images:
            png = np.frombuffer(images[t], np.uint8)
            mask = cv2.imdecode(png, cv2.IMREAD_GRAYSCALE)
            assert mask is not None  # the store has checked the table
        else:
            mask = rasterise(line, (camera.height, camera.width), LINE_WIDTH_PX)
        top, left, part = pixel_scores(mask, matching.dilations, matching.step_px)
        windows.append([begin, top, left, *part.shape])
        scores.append(part.ravel())
        tips.append(line[np.argmax(trial.s[in_frame])])
        begin += part.size
    return MatchingTarget(
        trial,
        matching,
        np.concatenate(scores),
        np.array(windows),
        np.array(tips),
        _point_weights(trial, matching.delta_w),
    )


def _point_weights(trial: PreparedTrial, delta_w: float) -> np.ndarray:
    """Weigh the mass points that each frame shows by Eq. 6, (F, n).

    w_i = 1 + (i - 1) delta_w. Points beyond the measured part of the string have weight
    0, for example if the tip is hidden.
    """
    string = trial.model.string
    s, half = string.arc_lengths(), string.segment_length / 2
    measured = pd.Series(np.clip(trial.s, 0, string.length)).groupby(trial.frame)
    first = measured.min().to_numpy()[:, None]
    last = measured.max().to_numpy()[:, None]
    shown = (s >= first - half) & (s <= last + half)
    return np.where(shown, 1 + np.arange(len(s)) * delta_w, 0.0)
