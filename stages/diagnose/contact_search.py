"""Where an effect that depends on place could act: on the string's way, not on all of
it, and not on the hand's.

Asked of the effect's own law, without any simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.stats import qmc

from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import TrialData
from stringcast.stages.model.effect import Effect, StringEffect, amplitude_parameters
from stringcast.stages.model.engine.stability import load_sum
from stringcast.stages.model.parameter import Parameter, parameter_values

LOG2_CANDIDATES = 13  # places of which it is asked, as a power of two
MAX_SIMULATED = 48  # of these that are simulated
# of the range of its size: a cushion's stiffness of a plane's
INITIAL_SIZE_FRACTION = 0.1
# of the string's places on its way, at most: what acts on more is no touch
MAX_TOUCHED_FRACTION = 0.1
# places on the string's way in a trial, and on the hand's in all
STRING_PATH_POINTS, HAND_PATH_POINTS = 1500, 300
REFINEMENT_CANDIDATES = 256  # places of which it is asked about the best ones
# candidates of which it is asked: what their law takes stays in the processor's cache
CANDIDATES_PER_BATCH = 64
DEPARTURE_SIGMAS = 3.0  # noises by which a string that was touched is somewhere else
# of the largest departure in any trial: what others lack besides is no touch
MIN_DEPARTURE_FRACTION = 0.3
# [s] between touch and departure, from which one is not the other: what is lacking is
# told as smoothly
CONTACT_DELAY_S = 0.1


@dataclass(frozen=True)
class ContactCandidates:
    """start: exponents (P,) with the effect absent. own: places of its size and of what
    says where. strings: the string's way in each trial, hand: all the hand's, arguments
    of laws (M,) each. departs: when what was measured departs from the string in each
    trial [s], infinite where it does not, (K,).
    """

    hypothesis: Hypothesis
    start: np.ndarray
    parameter_indices: list[int]
    string_paths: Sequence[Mapping[str, np.ndarray]]
    hand_path: Mapping[str, np.ndarray]
    departure_times: np.ndarray
    seed: int

    @property
    def effect(self) -> type[Effect]:
        """Whose places they are."""
        return self.hypothesis.causes[-1]

    def sample(self) -> np.ndarray:
        """Exponents (C, P) at which it acts, anywhere."""
        chi = np.repeat(self.start[None], 2**LOG2_CANDIDATES, axis=0)
        chi[:, self.parameter_indices] = qmc.Sobol(
            len(self.parameter_indices), seed=self.seed
        ).random_base2(LOG2_CANDIDATES)
        chi[:, self.parameter_indices[0]] = self.start[
            self.parameter_indices[0]
        ] + INITIAL_SIZE_FRACTION * (1 - self.start[self.parameter_indices[0]])
        return self._most_plausible(chi)

    def sample_near(
        self, chi: np.ndarray, reach: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Exponents (C', P) at which it acts, within reach of those given."""
        near, where = (
            np.repeat(chi, REFINEMENT_CANDIDATES // len(chi), axis=0),
            self.parameter_indices[1:],
        )
        near[:, where] = np.clip(
            near[:, where] + rng.uniform(-reach, reach, (len(near), len(where))), 0, 1
        )
        return self._most_plausible(near)

    def _most_plausible(self, chi: np.ndarray) -> np.ndarray:
        """Those by which the string is touched first when it departs, in each trial,
        and the hand never.
        """
        # first: the hand's way is short
        chi = chi[~self._force_is_nonzero(chi, self.hand_path).any(axis=1)]
        apart, shares = np.zeros(len(chi)), []
        for way, departs in zip(self.string_paths, self.departure_times, strict=True):
            pushed = self._force_is_nonzero(chi, way)
            end = way["t"][-1] + CONTACT_DELAY_S  # stands for never
            first = np.where(pushed.any(axis=1), way["t"][pushed.argmax(axis=1)], end)
            apart += np.minimum(np.abs(first - min(departs, end)), CONTACT_DELAY_S) ** 2
            shares.append(pushed.mean(axis=1))
        share = np.mean(shares, axis=0)
        touches = np.flatnonzero((share > 0) & (share < MAX_TOUCHED_FRACTION))
        return chi[touches[np.argsort(apart[touches], kind="stable")[:MAX_SIMULATED]]]

    def _force_is_nonzero(
        self, chi: np.ndarray, way: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Whether it acts there, (C, M)."""
        string, parts = (
            self.hypothesis.model.string,
            [np.zeros((0, len(way["x"])), dtype=bool)],
        )
        for some in (
            np.array_split(chi, -(-len(chi) // CANDIDATES_PER_BATCH))
            if len(chi)
            else []
        ):
            material = string.material(
                parameter_values(self.hypothesis.parameters, some)[
                    :, : len(string.parameters)
                ]
            )
            alone = string.with_only_effects(
                (cast("type[StringEffect]", self.effect),), material
            )
            parts.append(
                np.any(
                    load_sum(*alone, {name: each[None] for name, each in way.items()})
                    != 0,
                    axis=-1,
                )
            )
        return np.concatenate(parts)


def varied_parameters(effect: type[Effect]) -> list[Parameter]:
    """An effect's size, other components of that, and what says where or when: those
    with which it is tried.

    Others that start at an end of their range are sizes too (of friction, say), and
    stay absent.
    """
    return [
        p
        for p in effect.parameters
        if p in amplitude_parameters(effect) or p.low < p.start < p.high
    ]


def contact_candidates(
    data: TrialData, parent: Fit, hypothesis: Hypothesis, seed: int
) -> ContactCandidates:
    """Of the last cause of a hypothesis, on the way of its parent's string."""
    effect = hypothesis.causes[-1]
    own = hypothesis.parameter_indices(effect, varied_parameters(effect))
    values = parameter_values(parent.hypothesis.parameters, parent.chi[None])
    strings = [
        _thin_path(_string_path(trial, parent, values), STRING_PATH_POINTS)
        for trial in data.trials
    ]
    poses = np.concatenate(
        [
            parent.hypothesis.model.hand_motion(trial.motion, values).pose[0]
            for trial in data.trials
        ]
    )
    hand = _thin_path({"x": poses[:, 0], "y": poses[:, 1]}, HAND_PATH_POINTS)
    departs = _departure_times(data.trials, mean_discrepancy(data, parent))
    return ContactCandidates(
        hypothesis,
        hypothesis.exponents_from(parent.exponents),
        own,
        strings,
        hand,
        departs,
        seed,
    )


def _departure_times(
    trials: Sequence[PreparedTrial], lacking: Sequence[np.ndarray]
) -> np.ndarray:
    """When what a string lacks, (2 n,) over sigma of each trial, is first more than
    noise, and more than a share of the most in any trial [s]; infinite where it never
    is, (K,).
    """
    far = [
        np.linalg.norm(own.reshape(-1, 2), axis=1) * t.sigma
        for own, t in zip(lacking, trials, strict=True)
    ]
    least = MIN_DEPARTURE_FRACTION * max(each.max() for each in far)
    moments = [
        t.times[t.frame[own > np.maximum(DEPARTURE_SIGMAS * t.sigma, least)]]
        for own, t in zip(far, trials, strict=True)
    ]
    return np.array([each.min() if len(each) else np.inf for each in moments])


def _string_path(
    trial: PreparedTrial, parent: Fit, values: np.ndarray
) -> dict[str, np.ndarray]:
    """Of the fitted string through a trial: arguments of laws, (M,) each."""
    model = parent.hypothesis.model
    points = model.simulate_string(
        trial.motion, values, trial.times, trial.initial_state, trial.turn
    ).points[0]
    return path_arguments(points, model.string.arc_lengths(), trial.times)


def path_arguments(
    points: np.ndarray, s: np.ndarray, times: np.ndarray
) -> dict[str, np.ndarray]:
    """Arguments of laws, (M,) each, where a string's points (F, n, 2) [m] are but that
    in the hand. s: (n,) arc lengths [m]; times: (F,) [s].
    """
    velocity = (
        np.gradient(points, times, axis=0) if len(times) > 1 else np.zeros_like(points)
    )
    tangent = np.gradient(points, axis=1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    along, moment = np.meshgrid(s, times)
    axes = {"x": points, "vx": velocity, "ux": velocity, "tx": tangent}
    known = {name: array[..., 0] for name, array in axes.items()}
    known |= {name.replace("x", "y"): array[..., 1] for name, array in axes.items()} | {
        "s": along,
        "t": moment,
    }
    return {name: array[:, 1:].ravel() for name, array in known.items()}


def _thin_path(way: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Some places of a way, evenly, about `count`."""
    return {name: each[:: max(len(each) // count, 1)] for name, each in way.items()}
