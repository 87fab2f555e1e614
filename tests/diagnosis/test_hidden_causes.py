"""Diagnoses of datasets with and without hidden causes."""

import pytest

from stringcast.pipeline.settings.composition import compose_settings
from tests.benchmarks.diagnosis.study import diagnosis_document
from tests.benchmarks.simulators import draw
from tests.diagnosis.slow_casts import write_slow_casts

PROBABILITY_TOLERANCE = 1e-6
JUMP = {"camera.jump": 0.02, "camera.jump_when": 0.35}


@pytest.fixture
def diagnose(arm, camera, tmp_path):
    """Return a function that diagnoses two slow casts with hidden settings."""

    def observe_and_diagnose(hidden, only_cast=None):
        write_slow_casts(tmp_path / "data", arm, camera, hidden, only_cast)
        words = ["+experiment=diagnose", "string=paper", "diagnose.starts=4"]
        settings = compose_settings(words)
        return diagnosis_document(tmp_path / "data", settings)

    return observe_and_diagnose


def assert_found(document, parameter, true_value):
    """Check that one cause is named, with a parameter near its true value."""
    name = parameter.partition(".")[0]
    assert document["verdict"] == "effect"
    assert [cause["effect"] for cause in document["causes"]] == [name]
    estimate = document["causes"][0]["parameters"][parameter]["value"]
    assert estimate == pytest.approx(true_value, rel=0.1)
    weighed = [*document["causes"], *document["alternatives"]]
    total = sum(cause["probability"] for cause in weighed)
    assert total == pytest.approx(1.0, abs=PROBABILITY_TOLERANCE)
    assert document["next_experiment"] is None
    rms = document["gain"]["rms_m"]
    assert rms["extended"] < 0.7 * rms["base"]


def test_a_hidden_effect_is_found_with_its_size(diagnose):
    document = diagnose({"joint_gain.gain": 0.02})
    assert_found(document, "joint_gain.gain", 0.02)


@pytest.mark.long
def test_a_random_hidden_effect_is_found_with_its_size(tmp_path):
    dataset = draw("own_kernel", 4, "effect", ["clock_drift"])
    dataset.write(tmp_path / "data")
    settings = compose_settings(["+experiment=diagnose"])
    document = diagnosis_document(tmp_path / "data", settings)
    [cause] = dataset.truth.causes
    assert_found(document, "clock_drift.rate", cause.parameters["clock_drift.rate"])


@pytest.mark.long
def test_no_cause_is_named_if_none_is_hidden(diagnose):
    """No cause is named if none is hidden, except perhaps the mesh.

    Ten points of Eq. 1 are too few for this string. `test_other_simulations` has a
    faster test with the whole library.
    """
    document = diagnose({})
    assert {cause["effect"] for cause in document["causes"]} <= {"resolution"}
    assert document["verdict"] in ("none", "effect")


@pytest.mark.long
def test_a_cause_outside_the_library_is_unknown(diagnose):
    """A cause outside the library is reported as unknown.

    `test_forward_selection` has a faster test with an excluded cause.
    """
    document = diagnose(JUMP, only_cast=0)
    assert document["verdict"] == "unknown"
    assert document["causes"] == []
    assert document["unexplained"]["sentence"]
