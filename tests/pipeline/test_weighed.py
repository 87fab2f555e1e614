"""A weight that dataset.yaml states is known.

It hangs at the tip of the model, and is not fitted.
"""

import pytest
from omegaconf import OmegaConf

from stringcast.data.metadata import read_metadata
from stringcast.data.schema import DataError
from stringcast.pipeline.settings import composition, settings_from_runs


def composed(folder, string, *more):
    (folder / "dataset.yaml").write_text(f"format: 1\nstring: {string}\n")
    given = [f"trials={folder}", "mode=estimate", *more]
    return settings_from_runs.inherit_settings(
        OmegaConf.create(composition.compose_settings(given)),
        composition.given_names(given),
    )


def test_what_hangs_at_the_tip_is_known(tmp_path):
    found = composed(
        tmp_path,
        "{length: 0.4, mass: 0.42, tip_mass: 0.03}",
        "effects=[rest_curvature]",
    )
    assert found["effects"] == ["rest_curvature", "tip_mass"]
    known = found["parameter_values"]["tip_mass.ratio"]
    assert known["value"] == pytest.approx(0.03 / 0.42)
    assert known["low"] < known["value"] < known["high"]
    assert known["high"] - known["low"] < 0.01 * known["value"]


@pytest.mark.parametrize(
    "string", ["{length: 0.4, mass: 0.42}", "{length: 0.4, mass: 0.42, tip_mass: 0.0}"]
)
def test_where_nothing_hangs_there_nothing_is_said(tmp_path, string):
    found = composed(tmp_path, string)
    assert (found["effects"], found["parameter_values"]) == ([], {})


@pytest.mark.parametrize(
    ("string", "words"),
    [
        ("{length: 0.4, tip_mass: 0.03}", "needs the string's own mass"),
        (
            "{length: 0.4, mass: 0.4, tip_mass: -1}",
            "string.tip_mass is -1; it must be 0",
        ),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, string, words):
    (tmp_path / "dataset.yaml").write_text(f"format: 1\nstring: {string}\n")
    with pytest.raises(DataError, match=words):
        read_metadata(tmp_path)
