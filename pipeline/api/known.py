"""A string that is known: the model that a diagnosis or an estimation made, for all
that comes after.
"""

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

from stringcast.data.artifacts import PARAMETERS
from stringcast.data.file_checks import read_json
from stringcast.data.store import read_table, write_text
from stringcast.pipeline.cli.terminal import explain_hydra_error
from stringcast.pipeline.run.experiment import Experiment, prepare_experiment
from stringcast.pipeline.run.picture_source import refuse_unusable_source
from stringcast.pipeline.settings.composition import (
    UserError,
    compose_settings,
    given_names,
)
from stringcast.pipeline.settings.settings_from_runs import (
    EXTENDED,
    inherit_settings,
    read_extended_model,
    restore_given_settings,
)
from stringcast.stages.export.mjcf import build_mjcf
from stringcast.stages.model.model import Model


@dataclass(frozen=True)
class KnownString:
    """Settings `string`, `effects` and `parameter_values`, as an extended.yaml holds them; none is
    what conf/ says.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def load(cls, folder: str | Path) -> KnownString:
        """The string of the folder of a diagnosis or an alignment, or an extended.yaml.
        Raises StringcastError.
        """
        return cls(read_extended_model(Path(folder)))

    @classmethod
    def from_run(cls, folder: str | Path) -> KnownString:
        """The string of a run's folder: of its extended.yaml, or else its last
        estimate. Raises StringcastError.
        """
        whole = Path(folder)
        if not whole.exists():
            raise UserError(
                f"{whole}: there is no such folder. Name that of casts, an estimation or a diagnosis."
            )
        estimates = sorted(whole.glob("iterations/*/estimate/parameters.parquet"))
        if (whole / EXTENDED).exists() or not estimates:
            return cls.load(whole)
        settings, table = (
            read_json(whole / "config.json"),
            read_table(PARAMETERS, estimates[-1]),
        )
        sure = table["low"].notna() & table["high"].notna()
        known: dict[str, Any] = dict(
            zip(table["name"], table["value"].astype(float), strict=True)
        )
        known |= (
            table[sure]
            .set_index("name")[["value", "low", "high"]]
            .astype(float)
            .to_dict("index")
        )
        return cls(
            {
                "string": settings["string"],
                "effects": settings["effects"],
                "parameter_values": known,
            }
        )

    def save(self, folder: str | Path) -> Path:
        """Write extended.yaml, which `model_from=<folder>` takes. Returns its path."""
        path = Path(folder) / EXTENDED
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, yaml.safe_dump(dict(self.settings), sort_keys=False))
        return path

    @property
    def effects(self) -> list[str]:
        """Names of what is modelled beyond the paper."""
        return list(self.settings.get("effects", []))

    @property
    def parameters(self) -> dict[str, Any]:
        """The known parameters by name: a number, or a value with its interval."""
        return dict(self.settings.get("parameter_values", {}))

    def mjcf(self, mass: float, step: float = 5e-4) -> str:
        """The string as a chain of links for MuJoCo, see stages/export/mjcf.py. mass:
        of the string [kg]; step: [s].

        Raises StringcastError for an effect that MuJoCo has no law for.
        """
        model = experiment_for_call((), self).model
        return build_mjcf(model, model.values({}), mass, step)

    def __repr__(self) -> str:
        """The effects, and how many parameters are known."""
        return f"KnownString(effects={self.effects}, {len(self.parameters)} parameters known)"


def experiment_for_call(
    words: Sequence[str], string: KnownString | None, **given: Any
) -> Experiment:
    """All that a call works with. words: settings as on the command line, which stand
    above all. string: what is known of it. given: further settings by name.
    """
    try:
        asked, names = (
            OmegaConf.create(compose_settings(words) | given),
            given_names(words),
        )
    except HydraException as error:
        raise UserError(explain_hydra_error(error)) from error
    whole = asked.copy()
    for block, value in ({} if string is None else string.settings).items():
        OmegaConf.update(whole, block, value, merge=True)
    restore_given_settings(whole, asked, names)
    settings = inherit_settings(whole, names)
    refuse_unusable_source(settings, names)
    return prepare_experiment(settings, lambda block: f"conf/{block} or this call")


def model_for_call(settings: Sequence[str], string: KnownString | None) -> Model:
    """The model that a call works with, kept for the next: to compose its settings
    takes twenty times as long as to simulate. settings, string: as in `prepared`.
    """
    # folders, in which something may change
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
