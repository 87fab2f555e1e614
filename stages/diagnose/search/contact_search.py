"""The search of places where an effect that depends on place may act.

A contact acts on a part of the string's path, and nowhere on the hand's path. Only the
effect's own law is evaluated; nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.inference.hypothesis import Hypothesis
from stringcast.stages.inference.laplace import Fit, mean_discrepancy
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.inference.trial_data import ByTrial, TrialData
from stringcast.stages.model.effect import Effect, StringEffect, amplitude_parameters
from stringcast.stages.model.engine.stability import (
    DEFAULT_ARGUMENTS,
    load_sum,
    vector_slot_sum,
)
from stringcast.stages.model.parameter import Parameter, parameter_values

qmc = LazyModule("scipy.stats.qmc")  # takes 0.4 s

LOG2_CANDIDATES = 13
MAX_SIMULATED = 48  # candidates
INITIAL_SIZE_FRACTION = 0.1  # of the range of a stiffness: a cushion rather than a wall
MAX_TOUCHED_FRACTION = 0.1  # of the string's path: an effect on more is not a contact
STRING_PATH_POINTS = 1500  # in a trial
HAND_PATH_POINTS = 300  # in all trials
REFINEMENT_CANDIDATES = 256
CANDIDATES_PER_BATCH = 16  # the arguments of their laws fit into the processor's cache
FIELD_SAMPLES = 64  # candidates by which fields and contacts are distinguished
DEPARTURE_SIGMAS = 3.0
MIN_DEPARTURE_FRACTION = 0.3  # of the largest in any trial: smaller ones are ignored
# Between contact and departure: the smooth discrepancy responds with this delay
CONTACT_DELAY_S = 0.1


@dataclass(frozen=True)
class ContactCandidates:
    """Places where the last cause of a hypothesis may touch the string.

    Attributes
    ----------
    start : numpy.ndarray, shape (P,)
        Exponents with the cause absent.
    parameter_indices : list of int
        Indices of the cause's amplitude, then of its place and time.
    string_paths : sequence of dict
        The fitted string's path in each trial as arguments of laws, (M,) each.
    hand_path : dict
        The hand's path in all trials.
    departure_times : numpy.ndarray, shape (K,)
        Times at which the measured string departs from the fitted one [s]; infinite if
        it never does.
    """

    hypothesis: Hypothesis
    start: np.ndarray
    parameter_indices: list[int]
    string_paths: Sequence[Mapping[str, np.ndarray]]
    hand_path: Mapping[str, np.ndarray]
    departure_times: np.ndarray
    seed: int

    def sample(self) -> np.ndarray:
        """Sample plausible exponents (C, P) anywhere in the range."""
        return self._most_plausible(self._range_samples)

    def act_everywhere(self) -> bool:
        """Return whether the effect is a field, such as a spring to a fixed point.

        A field acts on much of the string's path from any place.
        """
        chi = self._range_samples[:FIELD_SAMPLES]
        fractions = []
        for path in self.string_paths:
            fractions.append(self._force_is_nonzero(chi, path).mean(axis=1))
        least = np.mean(fractions, axis=0).min()
        return bool(least >= MAX_TOUCHED_FRACTION)

    @cached_property
    def _range_samples(self) -> np.ndarray:
        """Exponents (C, P), spread evenly over the range, at the initial size."""
        indices = self.parameter_indices
        amplitude = indices[0]
        chi = np.repeat(self.start[None], 2**LOG2_CANDIDATES, axis=0)
        sobol = qmc.Sobol(len(indices), seed=self.seed)
        chi[:, indices] = sobol.random_base2(LOG2_CANDIDATES)
        absent = self.start[amplitude]
        chi[:, amplitude] = absent + INITIAL_SIZE_FRACTION * (1 - absent)
        return chi

    def sample_near(
        self,
        chi: np.ndarray,
        radius: float,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Sample plausible exponents (C', P) within a radius of given ones (C, P)."""
        near = np.repeat(chi, REFINEMENT_CANDIDATES // len(chi), axis=0)
        indices = self.parameter_indices[1:]  # all but the amplitude
        offset = rng.uniform(-radius, radius, (len(near), len(indices)))
        near[:, indices] = np.clip(near[:, indices] + offset, 0, 1)
        return self._most_plausible(near)

    def _most_plausible(self, chi: np.ndarray) -> np.ndarray:
        """Select candidates that touch the string when it departs, and never the hand.

        The best candidates do not touch the string in trials without a departure.
        """
        chi = chi[~self._force_is_nonzero(chi, self.hand_path).any(axis=1)]
        square_delay = np.zeros(len(chi))  # between touch and departure, over trials
        fractions = np.zeros(len(chi))  # of the path that is touched, over trials
        most = MAX_TOUCHED_FRACTION * len(self.string_paths)
        for path, departure in zip(
            self.string_paths, self.departure_times, strict=True
        ):
            touches = self._force_is_nonzero(chi, path)
            times = path["t"]
            after_end = times[-1] + CONTACT_DELAY_S  # stands for never
            first_touch = times[touches.argmax(axis=1)]
            first_touch = np.where(touches.any(axis=1), first_touch, after_end)
            delay = np.abs(first_touch - min(departure, after_end))
            square_delay += np.minimum(delay, CONTACT_DELAY_S) ** 2
            fractions += touches.mean(axis=1)
            # Drop those that already act on too much of the path
            possible = fractions < most
            chi = chi[possible]
            square_delay = square_delay[possible]
            fractions = fractions[possible]
        is_contact = fractions > 0
        contacts = np.flatnonzero(is_contact)
        order = np.argsort(square_delay[contacts], kind="stable")
        return chi[contacts[order[:MAX_SIMULATED]]]

    def _force_is_nonzero(
        self,
        chi: np.ndarray,
        path: Mapping[str, np.ndarray],
    ) -> np.ndarray:
        """Evaluate whether each candidate acts at each point of a path, (C, M)."""
        string = self.hypothesis.model.string
        parameters = self.hypothesis.parameters
        effect = cast("type[StringEffect]", self.hypothesis.causes[-1])
        arguments = {name: values[None] for name, values in path.items()}
        values = parameter_values(parameters, chi)
        material = string.material(values[:, : len(string.parameters)])
        only_this, own_material = string.with_only_effects((effect,), material)
        known = DEFAULT_ARGUMENTS | arguments
        vector_slots = sorted(effect.laws().keys() & {"acceleration", "flow"})

        is_nonzero = np.zeros((len(chi), len(path["x"])), dtype=bool)
        for first in range(0, len(chi), CANDIDATES_PER_BATCH):
            batch = slice(first, first + CANDIDATES_PER_BATCH)
            vectors = [load_sum(only_this, own_material[batch], arguments)]
            for slot in vector_slots:
                own = own_material[batch]
                vectors.append(vector_slot_sum(only_this, own, slot, known))
            for vector in vectors:  # component by component: a reduction is slow
                is_nonzero[batch] |= (vector[..., 0] != 0) | (vector[..., 1] != 0)
        return is_nonzero


def varied_parameters(effect: type[Effect]) -> list[Parameter]:
    """List an effect's amplitudes, and the parameters of its place and time.

    Other parameters that start at an end of their range, such as friction, stay there.
    """
    amplitudes = amplitude_parameters(effect)
    varied = []
    for parameter in effect.parameters:
        is_inside = parameter.low < parameter.start < parameter.high
        if is_inside or parameter in amplitudes:
            varied.append(parameter)
    return varied


def contact_candidates(
    data: TrialData,
    parent: Fit,
    hypothesis: Hypothesis,
    seed: int,
) -> ContactCandidates:
    """Prepare the search of contacts for the last cause of a hypothesis."""
    effect = hypothesis.causes[-1]
    model = parent.hypothesis.model
    values = parameter_values(parent.hypothesis.parameters, parent.chi[None])
    string_paths = []
    poses = []
    for trial in data.trials:
        simulated = model.simulate_string(
            trial.motion,
            values,
            trial.times,
            trial.initial_state,
            trial.turn,
        )
        points = simulated.points[0]
        path = path_arguments(points, model.string.arc_lengths(), trial.times)
        string_paths.append(_thin_path(path, STRING_PATH_POINTS))
        poses.append(model.hand_motion(trial.motion, values).pose[0])
    pose = np.concatenate(poses)
    hand_path = _thin_path({"x": pose[:, 0], "y": pose[:, 1]}, HAND_PATH_POINTS)
    return ContactCandidates(
        hypothesis,
        hypothesis.exponents_from(parent.exponents),
        hypothesis.parameter_indices(effect, varied_parameters(effect)),
        string_paths,
        hand_path,
        _departure_times(data.trials, mean_discrepancy(data, parent)),
        seed,
    )


def _departure_times(
    trials: Sequence[PreparedTrial],
    discrepancies: ByTrial,
) -> np.ndarray:
    """Find when the discrepancy of each trial, (2 n,) over sigma, is first large [s].

    It must exceed noise and a fraction of the largest one in any trial. Otherwise the
    time is infinite.
    """
    distances_m = []
    for trial, discrepancy in zip(trials, discrepancies, strict=True):
        distance = np.linalg.norm(discrepancy.reshape(-1, 2), axis=1)
        distances_m.append(distance * trial.sigma)
    largest_m = max(distance_m.max() for distance_m in distances_m)
    least_m = MIN_DEPARTURE_FRACTION * largest_m
    departures = []
    for trial, distance_m in zip(trials, distances_m, strict=True):
        is_large = distance_m > np.maximum(DEPARTURE_SIGMAS * trial.sigma, least_m)
        departures.append(trial.point_times[is_large].min(initial=np.inf))
    return np.array(departures)


def path_arguments(
    points: np.ndarray,
    s: np.ndarray,
    times: np.ndarray,
) -> dict[str, np.ndarray]:
    """Compute arguments of laws, (M,) each, along the path of a string.

    Parameters
    ----------
    points : numpy.ndarray, shape (F, n, 2)
        Mass points [m]; the one in the hand is left out.
    s : numpy.ndarray, shape (n,)
        Arc lengths [m].
    times : numpy.ndarray, shape (F,)
        Frame times [s].

    Returns
    -------
    dict
        Names have the prefixes of laws: v for velocity, u for velocity relative to
        still air, and t for the tangent.
    """
    velocity = np.zeros_like(points)
    if len(times) > 1:
        velocity = np.gradient(points, times, axis=0)
    tangent = np.gradient(points, axis=1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    arguments = {}
    for prefix, vectors in (
        ("", points),
        ("v", velocity),
        ("u", velocity),
        ("t", tangent),
    ):
        arguments[f"{prefix}x"] = vectors[..., 0]
        arguments[f"{prefix}y"] = vectors[..., 1]
    arguments["s"], arguments["t"] = np.meshgrid(s, times)
    return {name: values[:, 1:].ravel() for name, values in arguments.items()}


def _thin_path(path: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """Keep about `count` points of a path, evenly."""
    return {name: row[:: max(len(row) // count, 1)] for name, row in path.items()}
