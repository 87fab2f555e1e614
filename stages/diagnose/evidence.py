"""Trials to be explained, and how far candidates are from them.

What the number of mass points does to the string is of second order in their distance (with
half cells at both ends), so two numbers of points give a third result that is better than
both (Richardson's extrapolation), and three say how good that is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stringcast.stages.inference.batch import seen_together
from stringcast.stages.inference.forward import Case
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import values_of
from stringcast.stages.model.sampling import measured

LOST = 1e3  # residual of a run that was rejected, in standard deviations
DOUBT = 1.5  # the simulation's own error may be this much more than two pairs of numbers of segments differ
SHORTER = 4.0  # times, steps of candidates that were torn
TORN = 3.0  # lengths between the ends of a string
CHUNK = 128  # candidates simulated at once


@dataclass(frozen=True)
class Evidence:
    """cases: trials made ready, with sigma the noise of each point [m]. segments: two numbers of them, few and more,
    from which results are extrapolated; or one, whose results stand as they are. unsure: how each trial's points move
    with what is not known of the state in which it begins, (2 n, M) [m]; what such changes could explain counts for
    nothing."""

    cases: tuple[Case, ...]
    segments: tuple[int, ...]
    unsure: tuple[np.ndarray, ...] = ()

    @cached_property
    def trial(self) -> np.ndarray:
        """Number of the trial of each residual, (N,)."""
        return np.repeat(np.arange(len(self.cases)), [2 * len(case.points) for case in self.cases])

    @cached_property
    def sigma(self) -> np.ndarray:
        """(N,) [m]."""
        return np.concatenate([np.repeat(case.sigma, 2) for case in self.cases])

    def only(self, chosen: Sequence[int]) -> Evidence:
        """Some of the trials."""
        unsure = tuple(self.unsure[i] for i in chosen) if self.unsure else ()
        return replace(self, cases=tuple(self.cases[i] for i in chosen), unsure=unsure)

    def until(self, seconds: float | np.ndarray) -> Evidence:
        """The beginning of every trial; seconds: one for all, or of each [s]."""
        each = np.broadcast_to(seconds, len(self.cases))
        pairs = zip(self.cases, each, strict=True)
        shares = [min(some / max(case.times[-1] - case.times[0], 1e-9), 1.0) for case, some in pairs]
        cases = tuple(case.until(share) for case, share in zip(self.cases, shares, strict=True))
        lengths = [2 * len(case.points) for case in cases]
        unsure = tuple(m[:n] for m, n in zip(self.unsure, lengths, strict=True)) if self.unsure else ()
        return replace(self, cases=cases, unsure=unsure)

    @property
    def rough(self) -> Evidence:
        """With one number of segments alone: good enough for finding a beginning or a place."""
        return replace(self, segments=self.segments[:1])

    def residuals(self, model: Model, chi: np.ndarray) -> np.ndarray:
        """Simulated less measured over sigma, (C, N), for exponents (C, P); LOST where a run was rejected."""
        values = values_of(model.parameters, chi)
        result = np.empty((len(values), len(self.trial)))
        for first in range(0, len(values), CHUNK):
            some = slice(first, first + CHUNK)
            parts = [
                ((seen - case.points) / case.sigma[:, None]).reshape(len(seen), -1)
                for seen, case in zip(self.extrapolated(model, values[some], self.segments), self.cases, strict=True)
            ]
            result[some] = np.concatenate(self._sure(parts), axis=1)
        return np.nan_to_num(result, nan=LOST)

    def _sure(self, parts: list[np.ndarray]) -> list[np.ndarray]:
        """Residuals (C, 2 n) of each trial without what another beginning would explain."""
        if not self.unsure:
            return parts
        return [part - (part @ basis) @ basis.T for part, basis in zip(parts, self._bases, strict=True)]

    @cached_property
    def _bases(self) -> list[np.ndarray]:
        """(2 n, M) orthonormal, of each trial's residuals over sigma."""
        pairs = zip(self.unsure, self.cases, strict=True)
        return [np.linalg.qr(moves / np.repeat(case.sigma, 2)[:, None])[0] for moves, case in pairs]

    def scaled(self, factor: float) -> Evidence:
        """With another noise."""
        return replace(self, cases=tuple(replace(case, sigma=factor * case.sigma) for case in self.cases))

    def extrapolated(self, model: Model, values: np.ndarray, segments: tuple[int, ...]) -> list[np.ndarray]:
        """Where candidates (C, P) have each trial's measured points, (C, N, 2) [m]."""
        first, *more = (self._at_measured(model, values, number) for number in segments)
        for fine in more:
            weight = segments[0] ** 2 / (segments[1] ** 2 - segments[0] ** 2)
            return [b + weight * (b - a) for a, b in zip(first, fine, strict=True)]
        return first

    def _at_measured(self, model: Model, values: np.ndarray, segments: int) -> list[np.ndarray]:
        divided = model.divided(segments)
        seen = _tried_again(divided, self.cases, values, seen_together(divided, self.cases, values))
        length = divided.string.segment
        pairs = zip(seen, self.cases, strict=True)
        return [measured(points, case.frame, case.s / length) for points, case in pairs]

    def doubted(self, model: Model, chi: np.ndarray, segments: tuple[int, ...]) -> Evidence:
        """With sigma raised by the error of the simulation itself, as another two numbers of segments show it."""
        values = values_of(model.parameters, chi[None])
        here, there = (self.extrapolated(model, values, some) for some in (self.segments, segments))
        cases = zip(self.cases, here, there, strict=True)
        return replace(self, cases=tuple(_doubted(case, a[0], b[0]) for case, a, b in cases))


def _tried_again(model: Model, cases: Sequence[Case], values: np.ndarray, seen: list[np.ndarray]) -> list[np.ndarray]:
    """What is seen of candidates, those that were torn tried once more: steps that are right where the base model is
    can be too long for what else is asked."""
    lost = np.flatnonzero(np.any([torn(points, model.string.length) for points in seen], axis=0))
    if lost.size:
        again = seen_together(with_shorter_steps(model, SHORTER), cases, values[lost])
        for points, more in zip(seen, again, strict=True):
            points[lost] = more
    return seen


def with_shorter_steps(model: Model, times: float) -> Model:
    """The model with steps in time that are shorter by so many times."""
    return replace(model, string=replace(model.string, largest_step=model.string.largest_step / times))


def torn(points: np.ndarray, length: float) -> np.ndarray:
    """Whether candidates (C, F, n, 2) were rejected, or went apart as nothing does, (C,)."""
    reach = np.linalg.norm(points[:, :, -1] - points[:, :, 0], axis=-1).max(axis=1)
    return ~(reach < TORN * length)


def _doubted(case: Case, here: np.ndarray, there: np.ndarray) -> Case:
    error = DOUBT * np.nan_to_num(np.linalg.norm(here - there, axis=-1), nan=LOST)
    return replace(case, sigma=np.hypot(case.sigma, error))
