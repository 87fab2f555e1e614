"""Export of posterior samples and log-likelihoods to ArviZ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.inference.batch import normalised_residuals
from stringcast.stages.inference.prepared_trial import PreparedTrial
from stringcast.stages.model.model import Model

arviz = LazyModule("arviz")


def log_likelihoods(
    model: Model, trials: Sequence[PreparedTrial], draws: pd.DataFrame
) -> np.ndarray:
    """Return the log-likelihood of each draw in each trial, (N, K).

    Errors of the points are independent and normal, with the stated sigma.

    Parameters
    ----------
    model
        The estimated model.
    trials
        Trials used for the estimate.
    draws
        A row for each draw, with a column for each parameter of the model.
    """
    values = draws[[parameter.name for parameter in model.parameters]].to_numpy(float)
    by_trial = []
    for trial, residual in zip(
        trials, normalised_residuals(model, trials, values), strict=True
    ):
        constant = 2 * np.sum(np.log(trial.sigma * np.sqrt(2 * np.pi)))
        by_trial.append(-0.5 * np.sum(residual**2, axis=1) - constant)
    return np.stack(by_trial, axis=1)


def inference_data(
    model: Model, trials: Sequence[PreparedTrial], draws: pd.DataFrame
) -> Any:
    """Return draws of the posterior as ArviZ' InferenceData.

    It has the groups `posterior`, with a variable for each parameter, and
    `log_likelihood`, with the dimension `trial`. Draws are independent, in one chain.
    """
    posterior = {}
    for parameter in model.parameters:
        posterior[parameter.name] = draws[parameter.name].to_numpy(float)[None]
    data = arviz.from_dict(
        posterior=posterior,
        log_likelihood={"points": log_likelihoods(model, trials, draws)[None]},
        coords={"trial": [trial.name for trial in trials]},
        dims={"points": ["trial"]},
        attrs={"inference_library": "stringcast"},
    )
    for parameter in model.parameters:
        attributes = {"units": parameter.unit, "long_name": parameter.meaning}
        data.posterior[parameter.name].attrs |= attributes
    return data
