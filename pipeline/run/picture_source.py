"""Use a given source of pictures, or refuse it."""

from __future__ import annotations

from pathlib import Path

from stringcast.pipeline.run.experiment import Mode
from stringcast.pipeline.settings.composition import Settings, UserError
from stringcast.pipeline.settings.typed_settings import build_chosen

SOURCE_PLACES = {"path": "film", "folder": "folder of images"}  # by setting


def use_given_source(settings: Settings, given: set[str]) -> Settings:
    """Return the settings with a given source in place of the virtual camera.

    given: names of settings on the command line. Raises UserError for an unused or
    missing source.
    """
    hardware = settings["hardware"]
    given_sources = sorted(n for n in given if n.partition(".")[0] == "source")
    is_free = "source" in hardware and hardware["source"] is None
    if given_sources and is_free:
        hardware = {**hardware, "source": settings["source"]}
        settings = {**settings, "hardware": hardware}
    mode: Mode = build_chosen(settings["mode"], "mode", "conf/mode")
    used_sources = mode.picture_sources(settings)
    if given_sources and not used_sources:
        name = given_sources[-1]
        key = name.partition(".")[2]
        reason = "this films nothing"
        if mode.moves_arm(settings):
            reason = "the virtual lab films with its own camera"
        raise UserError(
            f"{name} = {settings['source'][key or '_target_']} (command line)",
            f"it would not be used: {reason}",
            "Leave it out, or give hardware=emulator, serial or dynamixel, or "
            "+experiment=calibrate. To read films of earlier casts: python -m "
            "pipeline import <films> --to mine",
        )
    for block in used_sources:
        for key, kind in SOURCE_PLACES.items():
            path = settings[block].get(key)
            if path is not None and not Path(path).exists():
                raise UserError(
                    f"{block}.{key} = {path} (conf/source or the command line)",
                    f"there is no such {kind}",
                    f"Give its path from {Path.cwd()}.",
                )
    return settings
