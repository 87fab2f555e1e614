"""All settings in the help have a description, and a unit where needed."""

import re

from stringcast.pipeline.cli.help_page import help_text
from stringcast.pipeline.settings import reference
from stringcast.pipeline.settings.composition import compose_settings, flatten_settings
from stringcast.pipeline.settings.setting_comments import setting_comments


def explained(name):
    parts = name.split(".")
    return any(
        ".".join(parts[:end]) in setting_comments() for end in range(len(parts), 0, -1)
    )


def test_help_explains_all_settings():
    settings = flatten_settings(compose_settings())
    assert len(settings) > 130
    bare = [
        name
        for name in settings
        if not name.endswith("_target_") and not explained(name)
    ]
    assert bare == []


def test_settings_with_units_state_them():
    wanted = (
        "arm.links",
        "arm.base",
        "arm.speed",
        "camera.px_per_m",
        "camera.fps",
        "string.length",
        "target.x",
    )
    wanted += (
        "generate.shortest",
        "generate.longest",
        "execute.before",
        "string.largest_step",
    )
    for name in wanted:
        assert re.search(r"\[(m|s|px/m|1/s|rad/s)\]", setting_comments()[name]), name


def test_settings_reference_is_up_to_date():
    """If this fails, run: python -m pipeline.settings.reference."""
    assert reference.reference_page() == reference.PAGE_FILE.read_text(encoding="utf-8")


def test_reference_states_values_and_meanings():
    page = reference.reference_page()
    assert re.search(
        r"^    camera\.width=640 +picture width, 16 to 20000 \[px\]$", page, re.M
    )
    assert "along_x, along_y -3…3 m/s" in page
    assert not re.search(r"^    \S+( \(default\))?$", page, re.M), (
        "a setting or option without a meaning"
    )


def test_help_comments_belong_to_the_chosen_option():
    shown = help_text(["+experiment=stringB", "estimate=least_squares"])
    assert re.search(r"\n  iterations: 20 +# largest number for each start", shown)
    assert re.search(
        r"\n  largest_step: 0.0002 +# of the simulation, 1e-6 to 0.1 \[s\]", shown
    )
    assert re.search(r"\n  x: 0.4 +# centre, to the right, -1000 to 1000 \[m\]", shown)
