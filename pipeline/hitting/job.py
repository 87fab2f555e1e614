"""One run of a hit study: a string of the bench cast at a target in one way, from one seed."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hardware.virtual.bench import Bench
from pipeline.hitting.desk import PointDesk
from pipeline.run import Iteration, cast
from pipeline.world import World, world
from stages.generate.curves import Curves, first_curves
from stages.generate.generate import MotionNotFoundError, arm_faults
from stages.model.hand import JointMotion

Config = Mapping[str, Any]
REFERENCES = 4  # casts on which a model's foretelling is measured, the same for all
REFERENCE_T = (0.3, 1.0)  # [s]
REFERENCE_ALPHA = 75.0  # [rad/s^2]


def settings(config: Config, case: Config, method: Config, seed: int, casts: int) -> dict[str, Any]:
    """Settings of one run. case: `specimen`, `target`, `obstacles` and what differs of `string`. method: `generate`,
    `estimate`, `memory`, and what differs of `string`."""
    own = copy.deepcopy(dict(config)) | {name: method[name] for name in ("generate", "estimate", "memory")}
    own |= {name: case[name] for name in ("specimen", "target", "obstacles")}
    own["string"] = {**own["string"], **case["string"], **method["string"]}
    own["hardware"] = own["hardware"] | {"specimen": case["specimen"]}
    own["hardware"]["obstacles"] = own["hardware"]["obstacles"] | {"boxes": case["obstacles"]["boxes"]}
    return own | {"seed": seed, "manipulations": casts, "steps": ["generate", "execute", "extract", "estimate"]}


def casts_of(own: Config, noise: float) -> list[dict[str, Any]]:
    """A row for each cast until one hits."""
    here = world(own, lambda block: f"conf/{block}")
    desk = PointDesk(here, noise)
    try:
        made: Sequence[Iteration] = cast(here, Path(), desk).iterations
    except MotionNotFoundError as error:
        return [{"cast": 1, "hit": False, "reason": str(error)}]  # the run counts as one that never hits
    truth = References(here, desk.benches[1])
    return [_row(i, seconds, truth) for i, seconds in zip(made, desk.seconds, strict=True)]


def _row(iteration: Iteration, seconds: float, truth: References) -> dict[str, Any]:
    assert iteration.verdict is not None
    plan, estimate = iteration.done["generate"].outcome.iloc[0], iteration.done["estimate"]
    row = {
        "cast": iteration.number,
        "hit": iteration.hit,
        "distance": iteration.verdict.distance,
        "chance": float(plan.get("chance", np.nan)),
        "planning": seconds,
        "residual": float(estimate.fit["rms_after"].iloc[0]),
        "foretelling": truth.off(estimate.values()),
    }
    return {name: value if np.isfinite(value) else None for name, value in row.items()}


class References:
    """Casts that nobody learns from, on which a model foretells the tip."""

    def __init__(self, here: World, bench: Bench) -> None:
        self.model, self.curves = here.model, reference_curves(here)
        self.motion = JointMotion(0.0, here.arm.tick, *self.curves.sampled(here.arm.tick, REFERENCE_T[1]))
        self.times = np.arange(0, REFERENCE_T[1], 2 * here.arm.tick)
        values = np.repeat(bench.values, REFERENCES, axis=0)
        self.tips = bench.model.true(self.motion, values, self.times).tip

    def off(self, values: Mapping[str, float]) -> float:
        """Root mean square distance of the foretold tip from the true one [m]."""
        own = np.repeat(self.model.values(values)[None], REFERENCES, axis=0)
        tips = self.model.true(self.motion, own, self.times).tip
        return float(np.sqrt(np.mean(np.sum((tips - self.tips) ** 2, axis=-1))))


def reference_curves(here: World) -> Curves:
    """The same movements whatever is compared."""
    rng = np.random.default_rng(0)
    curves = first_curves(here.arm, rng, 64, REFERENCE_T, REFERENCE_ALPHA)
    sampled = curves.sampled(here.arm.tick, REFERENCE_T[1])
    return curves.only(np.flatnonzero(arm_faults(here.arm, (), *sampled) == "")[:REFERENCES])
