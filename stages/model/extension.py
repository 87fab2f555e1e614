"""Extension of a model by the effects that its parameter names need."""

from __future__ import annotations

from collections.abc import Iterable

from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model


def extend_model(model: Model, parameter_names: Iterable[str]) -> Model:
    """Add the effects that own these parameters, except active ones.

    Parameters
    ----------
    model : Model
        The model to extend.
    parameter_names : iterable of str
        Qualified names, such as `tip_mass.ratio`. Those of the string have no dot.

    Returns
    -------
    Model
        The model with all these parameters.
    """
    known = {effect.name for effect in model.effects}
    names = dict.fromkeys(
        name.partition(".")[0] for name in parameter_names if "." in name
    )
    return model.with_effects(*find_effects([n for n in names if n not in known]))
