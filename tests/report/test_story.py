"""The first table of an adaptive run says what was predicted, happened, and why."""

from types import SimpleNamespace

import pandas as pd
import pytest

from stringcast.data.explanations import Explanation
from stringcast.stages.hit_test import HitResult
from stringcast.stages.report.pages.cast.story import story_card

MISSED = {"hit": False, "surprising": True}
HIT = {"hit": True, "surprising": False}


def explained(verdict, sentence):
    """Return an explanation with wind as its most probable cause."""
    nothing = pd.DataFrame()
    return Explanation(
        nothing,
        nothing,
        nothing,
        nothing,
        explanations=pd.DataFrame({"effects": ["wind"], "probability": [1.0]}),
        finding=pd.DataFrame([{"verdict": verdict, "sentence": sentence}]),
    )


def trial(found, hit, surprising, **plan):
    """Return a cast 12 mm from the target, whose hit had a probability of 0.9."""
    outcome = {"chance": 0.9, "chance_low": 0.85, "chance_high": 0.94} | plan
    return SimpleNamespace(
        is_valid=True,
        verdict=HitResult(hit, 0.25, 0.012),
        motion=SimpleNamespace(outcome=pd.DataFrame([outcome])),
        surprise=SimpleNamespace(is_surprising=surprising, p_value=0.004),
        explanation=found,
    )


def story_of(*casts, look=None):
    """Return the texts of the table's rows, without the first column."""
    record = SimpleNamespace(casts=casts, look=look, hit=casts[-1].verdict.hit)
    card = story_card(record, list(enumerate(casts, start=1)))
    if card is None:
        return None
    (table,) = card.parts
    return [row[1:] for row in table.rows]


def test_each_cast_has_its_prediction_result_reason_and_what_follows():
    look = trial(explained("not asked", "No cause was sought."), **HIT)
    first = trial(explained("cause", "With wind the tip is 1 mm off."), **MISSED)
    second = trial(explained("not asked", "No more."), **HIT)
    rows = story_of(first, second, look=look)
    assert rows[0][2:] == ["No cause was sought.", "a cast with the new estimate"]
    assert rows[1] == [
        "a hit, with probability 0.90 (0.85 to 0.94)",
        "missed, 12 mm from the target's centre; the path was a surprise (p = 0.004)",
        "With wind the tip is 1 mm off.",
        "a cast with wind in the model",
    ]
    assert rows[2][1].startswith("hit, 12 mm")
    assert "no surprise" in rows[2][1]
    assert rows[2][3] == "nothing: the target is hit"


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [
        ("candidates", "allows for each of the probable causes"),
        ("unknown", "allows for the misfit that is not explained"),
    ],
)
def test_the_next_plan_follows_from_the_verdict(verdict, expected):
    missed = trial(explained(verdict, "So."), **MISSED)
    again = trial(explained(verdict, "So."), correction=0.0312, **MISSED)
    rows = story_of(missed, again)
    assert expected in rows[0][3]
    assert "last miss corrected by 31.2 mm" in rows[0][3]
    assert "no casts are left" in rows[1][3]


def test_a_run_without_a_search_for_causes_has_no_story():
    assert story_of(trial(None, **HIT)) is None
