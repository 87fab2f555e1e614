"""Messages about films in which few frames were read."""

import ast
from pathlib import Path

import pandas as pd

from stringcast.stages import extract
from stringcast.stages.extract.reading_report import (
    REMEDIES,
    describe_arm_misfit,
    describe_poor_reading,
)


def readings(reasons):
    """Return readings; a frame without a reason was read."""
    return pd.DataFrame({"valid": [not r for r in reasons], "reason": reasons})


def test_a_mostly_read_film_needs_no_message():
    assert describe_poor_reading(readings(["", "", "no string in view"])) == ""
    assert describe_poor_reading(readings([])) == ""


def test_the_commonest_reason_is_reported_with_its_remedy():
    longer, hidden = "the line is longer than the string", "no string in view"
    sentence = describe_poor_reading(readings(["", longer, hidden, longer]))
    assert "only 1 of 4 frames" in sentence
    assert f"most often: {longer}" in sentence
    assert "may have come closer" in sentence
    assert "+experiment=align" in sentence


def test_an_unknown_reason_has_no_remedy():
    sentence = describe_poor_reading(readings(["fog", "fog"]))
    assert "fog" in sentence
    assert "Remedy" not in sentence


def test_a_displaced_arm_is_described_in_mm_and_degrees():
    plain = readings(["", ""])
    assert describe_arm_misfit(plain) == ""
    moved = plain.assign(hand_shift=[0.01, 0.029], joint_error=[0.05, 0.0942])
    sentence = describe_arm_misfit(moved)
    assert "up to 29 mm off" in sentence
    assert "5.4 degrees" in sentence
    assert "+experiment=align" in sentence


def test_every_reason_has_a_remedy():
    reasons = set()
    for file in Path(extract.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            is_call = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            if is_call and node.func.id == "UnreadableError":
                reasons.add(ast.literal_eval(node.args[0]))
    assert reasons == set(REMEDIES)
