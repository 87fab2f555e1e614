"""What a trial that nobody has made yet would say for one theory or another, as the diagnosis would then count it.

A `Prospect` is linear about the fits at hand: each theory may move its free parameters as far as the trials made
allow. Where a motion is violent that is far from what they can do, and a `Rehearsal` fits them really. All residuals
are over sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from stringcast.stages.diagnose.compare import blocks
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.diagnose.fit import Fit
from stringcast.stages.diagnose.verdict import weighed

DECIDED = float(np.log(20))  # log odds at which the data decide: below, `verdict` calls two causes alike


@dataclass(frozen=True)
class Outlook:
    """A theory before a new trial. past: its fit to the trials made. new: the same theory on the new trial, with
    residuals from any origin that all theories share."""

    past: Fit
    new: Fit

    def imagined(self, chance: float, draws: int, rng: np.random.Generator) -> np.ndarray:
        """Data of the new trial if this theory is true, (n, draws). chance: variance of what noise does in common."""
        return self.expected + self.scatter(chance, draws, rng)

    def scatter(self, chance: float, draws: int, rng: np.random.Generator) -> np.ndarray:
        """By how much they differ from what is expected, (n, draws)."""
        root = np.linalg.cholesky(np.linalg.inv(self.past.normal))
        moved = root @ rng.standard_normal((len(root), draws))
        noise = rng.standard_normal((len(self.new.residual), draws))
        return np.sqrt(chance) * (self.new.slopes @ moved + noise)

    @property
    def expected(self) -> np.ndarray:
        """Data of the new trial if this theory is as it was fitted and there is no noise, (n, 1)."""
        return self.new.residual[:, None]

    def refitted(self, data: np.ndarray) -> np.ndarray:
        """Residuals of all trials, the new one last, once the theory is fitted to all, (N + n, draws).

        data: of the new trial, (n, draws). Exponents stay in their range.
        """
        gap, slopes = self.expected - data, self.new.slopes
        chi = self.past.chi[self.past.theory.free][:, None]
        step = _bounded_step(self.past.normal + slopes.T @ slopes, slopes.T @ gap, chi)
        return np.concatenate([self.past.residual[:, None] + self.past.slopes @ step, gap + slopes @ step])


def _bounded_step(normal: np.ndarray, gradient: np.ndarray, chi: np.ndarray) -> np.ndarray:
    """Newton's steps (p, draws) from chi (p, 1). What would leave its range stops at its end, and the others are found
    anew. normal: (p, p), which may be singular: a base model that is far off can be steep beyond all else one way.
    gradient: (p, draws)."""
    free = -np.linalg.lstsq(normal, gradient)[0]
    stopped = np.clip(chi + free, 0, 1) - chi
    held = ((chi + free < 0) | (chi + free > 1)).T
    system = np.where(held[:, :, None], np.eye(len(normal)), normal)
    step = (np.linalg.pinv(system) @ np.where(held, stopped.T, -gradient.T)[:, :, None])[:, :, 0].T
    return np.clip(chi + step, 0, 1) - chi


@dataclass(frozen=True)
class Prospect:
    """A new trial. rivals: what each theory says of it; base: what the base model does. evidence: of the trials made;
    new: of this one, for its pieces of time. chance: `noisiness`."""

    rivals: Sequence[Outlook]
    base: Outlook
    evidence: Evidence
    new: Evidence
    chance: float

    @cached_property
    def pieces(self) -> csr_array:
        """(K, N + n) half the sum over each piece of time."""
        old, new = blocks(self.evidence), blocks(self.new)
        return _halved_sums(np.concatenate([old, old.max() + 1 + new]))

    def expected(self) -> np.ndarray:
        """Log odds (R, R) of each theory, if it is true and without noise, over each other."""
        return np.stack([self._odds(true, rival.expected)[:, 0] for true, rival in enumerate(self.rivals)])

    def drawn(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """The same with chance at work, (R, R, draws)."""
        imagined = (rival.imagined(self.chance, draws, rng) for rival in self.rivals)
        return np.stack([self._odds(true, data) for true, data in enumerate(imagined)])

    def _odds(self, true: int, data: np.ndarray) -> np.ndarray:
        """Log odds (R, draws) of one theory over each, in these data (n, draws)."""
        seen = [rival.refitted(data) for rival in self.rivals]
        number = [len(rival.past.theory.free) for rival in self.rivals]
        return _log_odds(self.pieces, seen, self.base.refitted(data), true, number, self.chance)


@dataclass(frozen=True)
class Rehearsal:
    """A new trial as if one theory were right: all of them really fitted to the trials made and to what it would show
    there. true: its number. right: how it stands. fits: of each theory; base: of the base model. evidence: of all
    trials, the new one last."""

    true: int
    right: Outlook
    fits: Sequence[Fit]
    base: Fit
    evidence: Evidence
    chance: float

    def expected(self) -> np.ndarray:
        """Log odds (R,) over each theory without noise."""
        return self._odds(np.zeros((len(self.right.new.residual), 1)))[:, 0]

    def drawn(self, draws: int, rng: np.random.Generator) -> np.ndarray:
        """The same with chance at work, (R, draws)."""
        return self._odds(self.right.scatter(self.chance, draws, rng))

    def _odds(self, change: np.ndarray) -> np.ndarray:
        """Log odds (R, draws) where the new trial's data differ from what is expected by change (n, draws)."""
        *seen, base = (_followed(fit, change) for fit in (*self.fits, self.base))
        number = [len(fit.theory.free) for fit in self.fits]
        return _log_odds(_halved_sums(blocks(self.evidence)), seen, base, self.true, number, self.chance)


def _halved_sums(piece: np.ndarray) -> csr_array:
    """(K, N) that makes half the sum over each piece of what it multiplies. piece: number of that of each, (N,)."""
    return csr_array((np.full(len(piece), 0.5), (piece, np.arange(len(piece)))))


def _followed(fit: Fit, change: np.ndarray) -> np.ndarray:
    """Residuals (N + n, draws) of a fit that follows, to first order, where the last data change by (n, draws)."""
    off = np.concatenate([np.zeros((len(fit.residual) - len(change), change.shape[1])), -change])
    return fit.residual[:, None] + off - fit.slopes @ np.linalg.solve(fit.normal, fit.slopes.T @ off)


def _log_odds(
    pieces: csr_array, seen: Sequence[np.ndarray], base: np.ndarray, true: int, number: Sequence[int], chance: float
) -> np.ndarray:
    """Log odds (R, draws) of one theory over each. seen: residuals of each, base: of the base model, (N + n, draws).
    number: of the parameters of each."""
    costs = [pieces @ residual**2 for residual in seen]
    apart = [pieces @ (residual - seen[true]) ** 2 for residual in seen]
    explained = (pieces @ base**2 - costs[true]).sum(axis=0)
    told = zip(costs, apart, number, strict=True)
    return np.stack([weighed(c - costs[true], a, explained, chance, number[true] - n) for c, a, n in told])


def again(fit: Fit, trial: np.ndarray, number: int) -> Fit:
    """A theory's fit on one of the trials made, as if it were performed once more. trial: of each residual, (N,)."""
    own = trial == number
    return replace(fit, residual=fit.residual[own], slopes=fit.slopes[own])
