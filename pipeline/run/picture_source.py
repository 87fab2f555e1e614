"""Where a run's pictures come from: refused before it begins where nothing would look
there, or where nothing is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stringcast.pipeline.run.experiment import Mode
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import build_chosen

# settings of a source that name a place, and what is there
SOURCE_PLACES = {"path": "film", "folder": "folder of images"}


def refuse_unusable_source(settings: Mapping[str, Any], given: set[str]) -> None:
    """Raise UserError for a source that nothing would look at, and for a film or a
    folder that is not there.

    settings: of the run. given: names on the command line.
    """
    mode: Mode = build_chosen(settings["mode"], "mode", "conf/mode")
    looked_at = mode.picture_sources(settings)
    named = sorted(name for name in given if name.partition(".")[0] == "source")
    if named and not looked_at:
        name = named[-1]
        block, _, key = name.partition(".")
        value = settings[block][key or "_target_"]
        # it makes trials, and does not look at stored ones
        casts = mode.moves_arm(settings)
        why = (
            "the virtual lab films with a camera of its own"
            if casts
            else "this films nothing"
        )
        raise UserError(
            f"{name} = {value} (command line): it would not be looked at, for {why}. Leave it out, or give what films: "
            "hardware=serial, hardware=dynamixel or +experiment=calibrate. Films of casts that were made are read by: "
            "python -m pipeline import <films> --to mine"
        )
    for block, key in (
        (name, key)
        for name in looked_at
        for key in SOURCE_PLACES.keys() & settings[name]
    ):
        place = settings[block][key]
        if place is not None and not Path(place).exists():
            raise UserError(
                f"{block}.{key} = {place} (conf/source or the command line): there is no such {SOURCE_PLACES[key]}. Name one "
                f"that is there, by its path from {Path.cwd()}."
            )
