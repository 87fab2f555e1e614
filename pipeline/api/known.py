"""A known string: the model of a diagnosis or an estimation, for later calls."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from hydra.errors import HydraException
from omegaconf import OmegaConf

from stringcast.data.estimates import PARAMETERS
from stringcast.data.file_checks import mark_yaml_end, read_json
from stringcast.data.store import read_table, write_text
from stringcast.pipeline.cli.terminal import explain_hydra_error
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.file_names import artifact_tables
from stringcast.pipeline.run.picture_source import use_given_source
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    given_names,
)
from stringcast.pipeline.settings.named_plugins import name_plugins
from stringcast.pipeline.settings.settings_from_runs import (
    inherit_settings,
    read_extended_model,
    restore_given_settings,
)
from stringcast.stages.export.mjcf import build_mjcf, choose_step
from stringcast.stages.model.model import Model
from stringcast.stages.spec import EXTENDED


@dataclass(frozen=True)
class KnownString:
    """The known settings of a string, as in extended.yaml.

    Parameters
    ----------
    settings : mapping, optional
        The settings `string`, `effects` and `parameter_values`; missing ones are taken
        from conf/.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, folder: str | Path) -> KnownString:
        """Load the model of a diagnosis or an alignment.

        Parameters
        ----------
        folder : str or Path
            The folder of the run, or an extended.yaml.

        Returns
        -------
        KnownString

        Raises
        ------
        StringcastError
            If there is no such model.
        """
        return cls(read_extended_model(Path(folder)))

    @classmethod
    def from_run(cls, folder: str | Path) -> KnownString:
        """Load the final string of a run.

        Parameters
        ----------
        folder : str or Path
            The folder of the run, with an extended.yaml or an estimate.

        Returns
        -------
        KnownString

        Raises
        ------
        StringcastError
            If the folder does not exist or holds neither.
        """
        run = Path(folder)
        if not run.exists():
            raise UserError(
                run,
                "there is no such folder",
                "Name that of casts, an estimation or a diagnosis.",
            )
        estimates = artifact_tables(run, "estimate", "parameters")
        if (run / EXTENDED).exists() or not estimates:
            return cls.load(run)
        settings = read_json(run / "config.json")
        for name in ("string", "effects"):
            if name not in settings:
                raise UserError(
                    run / "config.json",
                    f"the setting {name!r} is missing",
                    "Another version of this code made the run.",
                )
        table = read_table(PARAMETERS, estimates[-1]).set_index("name")
        if not table.index.is_unique:
            raise UserError(
                estimates[-1],
                "it has a parameter twice",
                "Delete it and run again.",
            )
        table = table[["value", "low", "high"]].astype(float)
        parameter_values: dict[str, Any] = table["value"].to_dict()
        # parameters with an interval
        parameter_values |= table.dropna().to_dict("index")
        return cls(
            {
                "string": settings["string"],
                "effects": settings["effects"],
                "parameter_values": parameter_values,
            }
        )

    def save(self, folder: str | Path) -> Path:
        """Write extended.yaml for `model_from=<folder>`.

        Parameters
        ----------
        folder : str or Path
            Folder to write to; made if it does not exist.

        Returns
        -------
        Path
            The file that was written.
        """
        path = Path(folder) / EXTENDED
        path.parent.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump(dict(self.settings), sort_keys=False)
        write_text(path, mark_yaml_end(text))
        return path

    @property
    def effects(self) -> list[str]:
        """Names of the effects beyond the paper."""
        return list(self.settings.get("effects", []))

    @property
    def parameters(self) -> dict[str, Any]:
        """The known parameters by name: a number, or a value with its interval."""
        return dict(self.settings.get("parameter_values", {}))

    def mjcf(self, mass: float, step: float | None = None) -> str:
        """Describe the string as a chain of links for MuJoCo.

        Parameters
        ----------
        mass : float
            Mass of the string [kg].
        step : float, optional
            Time step of the simulation [s]; by default the longest stable one.

        Returns
        -------
        str
            A document in MuJoCo's format, see stages/export/mjcf.py.

        Raises
        ------
        StringcastError
            If MuJoCo cannot represent an effect.
        """
        model = experiment_for_call((), self).model
        values = model.values({})
        return build_mjcf(model, values, mass, step or choose_step(model, values))

    def __repr__(self) -> str:
        """Return the effects and the number of known parameters."""
        count = len(self.parameters)
        return f"KnownString(effects={self.effects}, {count} parameters known)"


def experiment_for_call(
    words: Sequence[str], string: KnownString | None, **given: Any
) -> Experiment:
    """Compose the experiment of a call.

    `words` override the known string, which overrides conf/.
    """
    try:
        name_plugins(words)
        composed = OmegaConf.create(compose_settings(words) | given)
        names = given_names(words)
    except HydraException as error:
        reason = explain_hydra_error(error)
        raise UserError("", "the settings cannot be used", reason) from error
    config = composed.copy()
    for block, value in ({} if string is None else string.settings).items():
        OmegaConf.update(config, block, value, merge=True)
    restore_given_settings(config, composed, names)
    settings = use_given_source(inherit_settings(config, names), names)
    return prepare_experiment(settings, lambda block: f"conf/{block} or this call")


def model_for_call(settings: Sequence[str], string: KnownString | None) -> Model:
    """Compose the model of a call, with a cache.

    Composing settings takes twenty times as long as a simulation.
    """
    # the content of these folders may have changed
    if given_names(settings) & {"trials", "model_from", "camera_from"}:
        return experiment_for_call(settings, string).model
    return _cached_model(
        tuple(settings),
        None if string is None else json.dumps(string.settings, default=float),
    )


@lru_cache(8)
def _cached_model(settings: tuple[str, ...], string: str | None) -> Model:
    return experiment_for_call(
        settings, None if string is None else KnownString(json.loads(string))
    ).model
