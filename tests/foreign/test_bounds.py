"""All numbers in settings have bounds and satisfy them."""

import math

import pytest
import yaml
from omegaconf import OmegaConf

from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.bounds import bounds_of, refuse_numbers_out_of_bounds
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    UserError,
    compose_settings,
    flatten_settings,
)

NO_RUN_SETTINGS = ("hydra", "experiment")  # groups of the launcher and of whole runs


def is_number(value):
    if isinstance(value, list):
        return bool(value) and all(is_number(inner) for inner in value)
    return type(value) in (int, float)


def declared_numbers():
    """Return each number in the files of settings, by name and file."""
    numbers = []
    for file in sorted(CONF_FOLDER.rglob("*.yaml")):
        block = file.parent.relative_to(CONF_FOLDER).as_posix()
        content = yaml.safe_load(file.read_text()) or {}
        if block.startswith(NO_RUN_SETTINGS):
            continue
        if "@package _global_" in file.read_text() or block == ".":
            block = ""
        content.pop("hydra", None)
        for name, value in flatten_settings(content, block).items():
            if is_number(value):
                numbers.append((name, value))
    return numbers


def test_all_numbers_have_bounds_and_satisfy_them():
    numbers = declared_numbers()
    assert len(numbers) > 200
    for name, value in numbers:
        bounds = bounds_of(name)
        assert bounds is not None, f"{name}: its comment in conf states no bounds"
        assert bounds.low < bounds.high, name
        refuse_numbers_out_of_bounds({name: value}, lambda block: block)


def with_setting(name, value, *overrides):
    settings = OmegaConf.create(compose_settings(("hydra.run.dir=.", *overrides)))
    OmegaConf.update(settings, name, value, merge=False)
    return OmegaConf.to_container(settings, resolve=True)


@pytest.mark.parametrize(
    ("name", "value", "requirement"),
    [
        ("specimen.length", math.nan, "from 0.001 to 100 m"),
        ("specimen.length", -1, "from 0.001 to 100 m"),
        ("hardware.look.string_width", math.nan, "from 1e-05 to 1 m"),
        ("generate.alpha", math.inf, r"from 0.1 to 100000 rad/s\^2"),
        ("camera.fps", 1e9, "from 0.1 to 100000 1/s"),
        ("camera.origin_px", [0.0, math.inf], "from -1e\\+06 to 1e\\+06 px"),
        ("arm.tick", 1e-9, "from 0.0001 to 1 s"),
        ("string.largest_step", 1e-12, "from 1e-06 to 0.1 s"),
        ("string.ranges.axial_damping.low", "x", "a number from 0 to 1e\\+12 N s"),
        ("specimen.parameters.axial_damping", True, "a number from 0 to 1e\\+12"),
        ("trials_used", 0, "from 1 to 100000"),
        ("seed", 10**400, "from 0 to"),
        ("hardware.specimen.points", 10**9, "from 2 to 10000"),
        ("hardware.specimen.parameters.axial_damping", -1.0, "from 0 to 1e\\+12"),
    ],
)
def test_number_out_of_bounds_is_refused_by_its_given_name(name, value, requirement):
    """`diagnose.design.alpha` refers to `generate.alpha`."""
    settings = with_setting(name, value)
    block = name.partition(".")[0]
    with pytest.raises(
        UserError, match=rf"^{name} = .*\(file of {block}\): it must be {requirement}"
    ):
        prepare_experiment(settings, lambda name: f"file of {name}")


def test_picture_source_of_a_run_has_the_bounds_of_its_group():
    settings = with_setting(
        "hardware.source.seconds", 1e300, "hardware=serial", "source=device"
    )
    with pytest.raises(UserError, match=r"^hardware\.source\.seconds = 1e\+300"):
        prepare_experiment(settings, lambda block: block)


def test_boxes_in_a_list_have_bounds():
    box = {"x": 0.5, "y": 0.5, "w": 0.1, "h": 1e300}
    for name in ("obstacles.boxes", "hardware.obstacles.boxes"):
        with pytest.raises(UserError, match=r"boxes = 1e\+300 .* from -100 to 100 m"):
            prepare_experiment(with_setting(name, [box]), lambda block: block)


def test_range_without_a_number_is_refused():
    settings = with_setting("string.ranges.axial_damping.low", None)
    with pytest.raises(UserError, match=r"^string\.ranges\.axial_damping\.low = None"):
        prepare_experiment(settings, lambda block: block)


def test_words_allowed_instead_of_numbers_are_accepted():
    prepare_experiment(with_setting("trials_used", "all"), lambda block: block)
