"""The noise floor, from the data themselves, and points that are far out.

What a model lacks changes little from frame to frame; noise does not. So the second
difference in time of a residual is noise, whatever the model lacks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from stringcast.data.dataset import FRAMES_NEEDED
from stringcast.stages.common import mad_sigma, tracked
from stringcast.stages.diagnose.evidence import Evidence
from stringcast.stages.inference.forward import Case

FEWEST = 30  # second differences from which a noise can be told
CLEAR = 4.0  # standard deviations that noise alone may reach somewhere, averaged over neighbouring frames
COMMON = 0.15  # mean square that frames of a right model may have in common: mass points and doubt are not perfect
FAINT = 0.02  # less in common than this is nothing
BESIDE = 0.2  # of the string's measured length: points nearer than that are beside each other
GAP = 1.5  # times the usual time from point to point: more is a gap
EXACT = 1e-9  # [m] points nearer than that are the same
SMOOTH = 3  # frames whose residuals are averaged to see what they share
PASSES = 2  # of looking for points that are out
FAR = 6.0  # noises from its neighbours in time at which a point is left out
ASTRAY = 10.0  # noises by which a model is far off in a trial


def tracks(case: Case) -> Iterator[np.ndarray]:
    """Indices of the measured points of each place on the string, in the order of time."""
    yield from tracked(case.frame, case.s)


def estimated(evidence: Evidence, residual: np.ndarray) -> float:
    """Noise over sigma, as residuals (N,) over sigma show it from frame to frame; their size where frames are few.

    Never less than rounding makes of points that are told in steps.
    """
    pairs = zip(evidence.cases, parts(evidence, residual), strict=True)
    rough = np.concatenate([_second_differences(case, part) for case, part in pairs])
    noise = mad_sigma(residual) if len(rough) < FEWEST else mad_sigma(rough) / np.sqrt(6)
    return max(float(noise), rounding(evidence) / float(np.median(evidence.sigma)))


def rounding(evidence: Evidence) -> float:
    """Standard deviation of what rounding takes from points that are told in steps, such as whole pixels [m]; next to
    nothing for others."""
    points = np.concatenate([case.points for case in evidence.cases])
    steps = [np.diff(np.unique(coordinate)) for coordinate in points.T]
    real = [step[step > EXACT] for step in steps]
    return min((float(step.min()) for step in real if step.size), default=0.0) / np.sqrt(12)


def parts(evidence: Evidence, residual: np.ndarray) -> list[np.ndarray]:
    """Residuals (N,) of each trial, (n, 2)."""
    ends = np.cumsum([2 * len(case.points) for case in evidence.cases])[:-1]
    return [part.reshape(-1, 2) for part in np.split(residual, ends)]


def _second_differences(case: Case, residual: np.ndarray) -> np.ndarray:
    """Of residuals (n, 2) along each track, where frames follow one another evenly and not all tell the same point."""
    found = [np.empty(0)]
    for track in tracks(case):
        value, follows = residual[track], following(case, track)
        gap = np.diff(case.times[case.frame[track]])
        told = (np.diff(case.points[track], axis=0) != 0).any(axis=1)
        fresh = follows[1:] & follows[:-1] & (told[1:] | told[:-1]) & np.isclose(gap[1:], gap[:-1], rtol=0.2)
        found.append((value[2:] - 2 * value[1:-1] + value[:-2])[fresh].ravel())
    return np.concatenate(found)


def following(case: Case, track: np.ndarray) -> np.ndarray:
    """Whether each point of a track but the first follows the one before it without a gap, (n - 1,)."""
    gap = np.diff(case.times[case.frame[track]])
    return gap < GAP * np.median(gap) if gap.size else np.zeros(0, dtype=bool)


def systematic(evidence: Evidence, residual: np.ndarray) -> float:
    """Mean square of what residuals (N,) over sigma have in common from frame to frame: what is not noise."""
    products, count = 0.0, 0
    for case, part in zip(evidence.cases, parts(evidence, residual), strict=True):
        for track in tracks(case):
            follows = following(case, track)
            products += float(np.sum((part[track][1:] * part[track][:-1])[follows]))
            count += 2 * int(follows.sum())
    return max(products / max(count, 1), 0.0)


def alongside(evidence: Evidence, residual: np.ndarray) -> float:
    """Mean square of what residuals (N,) over sigma have in common with those beside them on the string, in the same
    frame; infinite where too few are near each other."""
    products, count = 0.0, 0
    for case, part in zip(evidence.cases, parts(evidence, residual), strict=True):
        beside = (np.diff(case.frame) == 0) & (np.diff(case.s) < BESIDE * case.s.max())
        products += float(np.sum((part[1:] * part[:-1])[beside]))
        count += 2 * int(beside.sum())
    return max(products / count, 0.0) if count >= FEWEST else np.inf


def visible(evidence: Evidence, residual: np.ndarray) -> float:
    """The largest residual (N,) over sigma that neighbours in time share: what somebody would point at."""
    return float(visible_in_each(evidence, residual).max(initial=0.0))


def visible_in_each(evidence: Evidence, residual: np.ndarray) -> np.ndarray:
    """The same of each trial, (K,)."""
    largest = np.zeros(len(evidence.cases))
    for number, (case, part) in enumerate(zip(evidence.cases, parts(evidence, residual), strict=True)):
        for track in tracks(case):
            smooth = uniform_filter1d(part[track], SMOOTH, axis=0)
            largest[number] = max(largest[number], np.linalg.norm(smooth, axis=1).max())
    return largest


def mismatch(evidence: Evidence, residual: np.ndarray) -> float:
    """How much residuals (N,) over sigma show that is not noise, as a logarithm: above 0 something is there.

    Of the largest thing to be seen, and of what both frames and neighbours on the string have in common everywhere:
    noise may last for some frames, or be that of a whole frame, but what a model lacks does both.
    """
    size = visible(evidence, residual) / CLEAR
    common = min(systematic(evidence, residual), alongside(evidence, residual))
    return float(np.log(size) + 0.5 * np.log(max(common, FAINT) / COMMON))


def cleaned(evidence: Evidence, residual: np.ndarray) -> tuple[Evidence, int]:
    """Without points whose residual (N,) over sigma is far from those just before and after, and how many these are.

    One may hide another, so it is asked again without those found.
    """
    size, whole = estimated(evidence, residual), len(residual)
    for _ in range(PASSES):
        pairs = zip(evidence.cases, parts(evidence, residual), strict=True)
        kept = [_kept(case, part, size) for case, part in pairs]
        cases = tuple(_only(case, near) for case, near in zip(evidence.cases, kept, strict=True))
        evidence, residual = replace(evidence, cases=cases), residual[np.repeat(np.concatenate(kept), 2)]
    return evidence, (whole - len(residual)) // 2


def scattered(evidence: Evidence, residual: np.ndarray) -> list[str]:
    """Trials whose points are so scattered, as residuals (N,) over sigma have it, that too few of their frames have one
    that is near those just before and after."""
    size, pairs = estimated(evidence, residual), zip(evidence.cases, parts(evidence, residual), strict=True)
    return [case.name for case, part in pairs if not _enough(case, _near(case, part, size))]


def _enough(case: Case, kept: np.ndarray) -> bool:
    return len(np.unique(case.frame[kept])) >= FRAMES_NEEDED


def _kept(case: Case, residual: np.ndarray, size: float) -> np.ndarray:
    """Which points (n,) are not out: all of them where too few frames would be left."""
    near = _near(case, residual, size)
    return near if _enough(case, near) else np.ones(len(near), dtype=bool)


def _near(case: Case, residual: np.ndarray, size: float) -> np.ndarray:
    """Which points (n,) are about where the frames before and after have them. size: of the noise.

    Where the model is far off, what it leaves changes fast, too: then a point is out only if those beside it on the
    string are not as far out.
    """
    jump = _jumps(case, residual)
    near = np.linalg.norm(jump, axis=1) < FAR * size
    if np.mean(residual**2) > (ASTRAY * size) ** 2:
        near |= np.linalg.norm(jump - _beside(case, jump), axis=1) < FAR * size
    return near


def _jumps(case: Case, residual: np.ndarray) -> np.ndarray:
    """How far residuals (n, 2) are from the median of five frames about them; those of no place that was followed so
    long, from what others near them are."""
    jump, alone = np.zeros(residual.shape), np.ones(len(residual), dtype=bool)
    for track in tracks(case):
        if len(track) < 5:
            continue
        alone[track] = False
        padded = np.pad(residual[track], ((2, 2), (0, 0)), mode="reflect")
        middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1)
        jump[track] = residual[track] - middle
    for one in np.flatnonzero(alone):
        others = np.flatnonzero((np.abs(case.frame - case.frame[one]) <= 2) & ~alone)
        jump[one] = _away(case, residual, int(one), others)
    return jump


def _away(case: Case, residual: np.ndarray, one: int, others: np.ndarray) -> np.ndarray:
    """How far the residual (n, 2) of one point is from the median of the five nearest others, or from what is between
    those in its frame, whichever is less: one of these may be far out, and a string that whips changes fast; (2,)."""
    if len(others) < 5:
        return np.zeros(2)
    near = others[np.argsort(np.abs(case.s[others] - case.s[one]))[:5]]
    away = [residual[one] - np.median(residual[near], axis=0)]
    now = others[case.frame[others] == case.frame[one]]
    if len(now) > 1:
        away.append(residual[one] - [np.interp(case.s[one], case.s[now], axis) for axis in residual[now].T])
    return min(away, key=lambda each: float(np.linalg.norm(each)))


def _beside(case: Case, jump: np.ndarray) -> np.ndarray:
    """The mean of what the points just before and after on the string do in the same frame, (n, 2); 0 without any."""
    same = (np.diff(case.frame) == 0)[:, None]
    total, count = np.zeros(jump.shape), np.zeros((len(jump), 1))
    total[1:] += same * jump[:-1]
    total[:-1] += same * jump[1:]
    count[1:] += same
    count[:-1] += same
    return total / np.maximum(count, 1)


def _only(case: Case, kept: np.ndarray) -> Case:
    return replace(case, **{name: getattr(case, name)[kept] for name in ("frame", "s", "points", "sigma")})
