"""Whether a cause outside the library could pass for one of its effects."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stringcast.stages.model.effect import Effect, StringEffect, amplitude_parameters
from stringcast.stages.model.effects.contact import Contact
from stringcast.stages.model.effects.grasp_slip import GraspSlip
from tests.benchmarks.simulators.blind.scene import Scene, unexplained

LITTLE = 0.03  # of an effect's range
PLANES = np.arange(8) * np.pi / 4  # tilts that are tried [rad]
ONSETS = (0.05, 0.2, 0.35, 0.5)  # of a slip, all together [s]


def aliased(scene: Scene, data: np.ndarray, least: float) -> bool:
    """Some single effect of the library, with other base parameters, leaves less than
    `least` sigmas at the tip.

    data: (N, S, 2) in sigmas. All is taken to be linear about the true base.
    """
    now, slopes = scene.slopes(
        scene.model(scene.second_order(21)), scene.base, tuple(scene.base)
    )
    left = (
        unexplained((data - now)[None], np.concatenate([slopes, moved]))[0]
        for moved in _probed(scene, now)
    )
    return any(scene.at_tip(some) < least for some in left)


def _probed(scene: Scene, now: np.ndarray) -> Iterator[np.ndarray]:
    """Changes of the points under a little of each library effect, (K, N, S, 2); its
    directions can act together.
    """
    on_string = [
        effect for effect in scene.version.library() if issubclass(effect, StringEffect)
    ]
    groups = [group for effect in on_string for group in _probes(effect, scene)]
    model = scene.model(scene.second_order(21), [Contact])
    moved = scene.seen(model, [probe for group in groups for probe in group]) - now
    finite = np.isfinite(moved).all(axis=(1, 2, 3))
    for which in np.split(
        np.arange(len(moved)), np.cumsum([len(group) for group in groups])[:-1]
    ):
        yield moved[which[finite[which]]]
    for effect in scene.version.library():
        if not issubclass(effect, StringEffect):
            model = scene.model(scene.second_order(21), [effect])
            for group in _probes(effect, scene):
                yield scene.seen(model, group) - now


def _probes(effect: type[Effect], scene: Scene) -> list[list[dict[str, float]]]:
    """Small amounts of a library effect, in each of its directions; another plane is
    another contact.
    """
    if effect is Contact:
        plain = scene.model(scene.second_order(21))
        values = plain.values(scene.base)[None]
        strings = [
            plain.simulate_string(cast.happened, values, cast.frames).points[0]
            for cast in scene.casts
        ]
        probes = []
        for tilt in map(float, PLANES):
            normal = np.array([-np.sin(tilt), np.cos(tilt)])
            height = (
                float(min((points @ normal).min() for points in strings)) + 0.01
            )  # where the string just touches it
            probes.append(
                [
                    {
                        "contact.tilt": tilt,
                        "contact.stiffness": 2e4,
                        "contact.height": height,
                    }
                ]
            )
        return probes
    if effect is GraspSlip:
        return [
            [{"grasp_slip.speed": 0.02, "grasp_slip.onset": onset} for onset in ONSETS]
        ]
    return [
        [
            {effect.qualified_name(p): p.start + LITTLE * (p.high - p.start)}
            for p in amplitude_parameters(effect)
        ]
    ]
