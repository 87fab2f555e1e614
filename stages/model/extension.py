"""Extension of a model by the effects whose parameters an estimate holds."""

from __future__ import annotations

from collections.abc import Iterable

from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model


def extend_model(model: Model, parameter_names: Iterable[str]) -> Model:
    """Add the effects that own these parameters, unless they are active.

    Parameters
    ----------
    model : Model
        The model without them.
    parameter_names : iterable of str
        Qualified names, such as `tip_mass.ratio`. Those of the string have no dot.

    Returns
    -------
    Model
        With one parameter of each name.
    """
    known = {effect.name for effect in model.effects}
    names = dict.fromkeys(
        name.partition(".")[0] for name in parameter_names if "." in name
    )
    return model.with_effects(*find_effects([n for n in names if n not in known]))
