"""One explanation of a run."""

from __future__ import annotations

import numpy as np

from stringcast.data.artifacts import (
    Estimate,
    Explanation,
    Surprise,
    TrialSet,
)
from stringcast.stages.estimate.least_squares import MISFIT_RATIO
from stringcast.stages.estimate.trim import trim_at_contact
from stringcast.stages.explain.comparison import noise_m, rms_m
from stringcast.stages.explain.noise_ratios import is_error_of_mesh
from stringcast.stages.spec import StageCall


def run(
    call: StageCall,
    trials: TrialSet,
    estimate: Estimate,
    surprise: Surprise,
    previous: Explanation | None,
) -> Explanation:
    """Explain trials, cut where their string touches an obstacle.

    A trial that nothing predicted, such as a look, is slow and shows little of what a
    cast will. It surprises if the estimate leaves more than noise and the error of the
    mesh.
    """
    setup = call.setup
    observations = [trim_at_contact(t, setup.obstacles) for t in trials.observations]
    is_surprising = surprise.is_surprising
    if np.isnan(surprise.p_value):
        is_more_than_noise = rms_m(estimate) > MISFIT_RATIO * noise_m(observations)
        is_surprising = is_more_than_noise and not is_error_of_mesh(
            setup.model, observations, estimate
        )
    target = setup.target
    explanation: Explanation = call.by(
        setup.model,
        observations,
        estimate,
        previous,
        is_surprising,
        min(target.w, target.h) / 2,
        seed=call.seed,
        manipulation=call.number,
        progress=call.progress,
    )
    return explanation
