"""The verdict as a pure function of a few numbers, and their computation."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_trials import CRITERIA

from stringcast.stages.diagnose.evidence.measures import mean_explained_fraction
from stringcast.stages.diagnose.rules import VerdictNumbers
from stringcast.stages.diagnose.verdict import (
    RESOLUTION,
    decide_verdict,
    name_causes,
)

FOUND = VerdictNumbers(
    trials=4,
    causes=("wind",),
    credible_sets=(("wind",),),
    inclusion_probability={"wind": 0.97, "clamp": 0.02},
    misfit_probability=0.1,
    base_misfit_probability=1.0,
    explained_fraction=0.8,
    heldout_is_closer=True,
    heldout_explained_fraction=0.8,
)
NOTHING = VerdictNumbers(trials=4, base_misfit_probability=0.1, explained_fraction=0.0)
PAIR = ("wind", "clamp")

TABLE = {
    # changed numbers, verdict, named causes
    "a cause that explains enough": (FOUND, {}, "effect", ("wind",)),
    "with a look-alike": (FOUND, {"credible_sets": (PAIR,)}, "ambiguous", PAIR),
    "two causes, one look-alike": (
        FOUND,
        {"causes": ("wind", "tilt"), "credible_sets": (("wind",), ("tilt", "clamp"))},
        "ambiguous",
        ("wind", "tilt", "clamp"),
    ),
    "explains too little": (FOUND, {"explained_fraction": 0.49}, "unknown", ()),
    "explains too little of little": (
        FOUND,
        {"explained_fraction": 0.49, "base_misfit_probability": 0.5},
        "none",
        (),
    ),
    "misfit remains": (FOUND, {"misfit_probability": 0.6}, "partial", ("wind",)),
    "misfit remains, with a look-alike": (
        FOUND,
        {"misfit_probability": 0.6, "credible_sets": (PAIR,)},
        "partial",
        PAIR,
    ),
    "misfit remains, explains little": (
        FOUND,
        {"misfit_probability": 0.6, "explained_fraction": 0.05},
        "partial",
        ("wind",),
    ),
    "misfit grows": (
        FOUND,
        {"misfit_probability": 0.6, "explained_fraction": -0.05},
        "unknown",
        (),
    ),
    "no place holds a cause": (
        FOUND,
        {"misfit_probability": 0.6, "credible_sets": ()},
        "unknown",
        (),
    ),
    "predicts no trial left out": (FOUND, {"heldout_is_closer": False}, "unknown", ()),
    "predicts little of them": (
        FOUND,
        {"heldout_explained_fraction": 0.4},
        "effect",
        ("wind",),
    ),
    "misfit remains, predicts little": (
        FOUND,
        {"misfit_probability": 0.6, "heldout_explained_fraction": 0.05},
        "partial",
        ("wind",),
    ),
    "misfit remains, tips are farther": (
        FOUND,
        {"misfit_probability": 0.6, "heldout_explained_fraction": -0.05},
        "unknown",
        (),
    ),
    "one trial": (FOUND, {"trials": 1}, "insufficient", ()),
    "one trial, unexplained": (
        FOUND,
        {"trials": 1, "explained_fraction": 0.1},
        "insufficient",
        (),
    ),
    "a trial diverges": (FOUND, {"diverged": True}, "insufficient", ()),
    "nothing to explain": (NOTHING, {}, "none", ()),
    "nothing found": (NOTHING, {"base_misfit_probability": 0.6}, "unknown", ()),
    "one trial, nothing": (NOTHING, {"trials": 1}, "none", ()),
    "simulation is uncertain": (
        NOTHING,
        {"unresolved_m": 9e-3},
        "insufficient",
        (),
    ),
    "simulation is uncertain, and misfit": (
        NOTHING,
        {"unresolved_m": 9e-3, "base_misfit_probability": 0.6},
        "unknown",
        (),
    ),
    "a coarse mesh": (NOTHING, {"mesh_too_coarse": True}, "effect", (RESOLUTION,)),
    "a coarse mesh in one trial": (
        NOTHING,
        {"mesh_too_coarse": True, "trials": 1},
        "effect",
        (RESOLUTION,),
    ),
    "a coarse mesh, and misfit": (
        NOTHING,
        {"mesh_too_coarse": True, "base_misfit_probability": 0.6},
        "unknown",
        (),
    ),
    "a coarse mesh, and a cause": (
        FOUND,
        {"mesh_too_coarse": True},
        "effect",
        ("wind",),
    ),
}


@pytest.mark.parametrize(
    ("numbers", "changed", "kind", "causes"), TABLE.values(), ids=TABLE
)
def test_verdict_follows_from_numbers(numbers, changed, kind, causes):
    decided = decide_verdict(replace(numbers, **changed), CRITERIA)
    assert (decided.kind, decided.causes) == (kind, causes)


def test_no_cause_is_suggested_if_simulation_is_uncertain():
    single = replace(FOUND, trials=1)
    remark = decide_verdict(single, CRITERIA).remark
    assert "it would be wind (0.97)" in remark
    uncertain = replace(single, unresolved_m=9.2e-3)
    remark = decide_verdict(uncertain, CRITERIA).remark
    assert "wind" not in remark
    assert "uncertain by up to 9.2 mm" in remark
    diverging = replace(single, unresolved_m=np.inf)
    assert "diverges on a finer mesh" in decide_verdict(diverging, CRITERIA).remark


def test_verdict_has_the_misfit_probability_of_its_model():
    assert decide_verdict(FOUND, CRITERIA).misfit_probability == 0.1
    poor = replace(FOUND, explained_fraction=0.2)
    assert decide_verdict(poor, CRITERIA).misfit_probability == 1.0
    unpredictive = replace(FOUND, heldout_is_closer=False)
    assert decide_verdict(unpredictive, CRITERIA).misfit_probability == 0.1


def test_look_alikes_are_grouped():
    sets = (("wind",), ("tilt", "clamp"))
    numbers = replace(FOUND, causes=("wind", "tilt"), credible_sets=sets)
    assert decide_verdict(numbers, CRITERIA).lookalike_groups == (("tilt", "clamp"),)


def test_causes_are_named_before_they_are_confirmed():
    """Held-out trials are searched only if no cause is named in the others."""
    assert name_causes(replace(FOUND, trials=1), CRITERIA).causes == ("wind",)


def test_remark_states_the_closest_explanation():
    numbers = replace(FOUND, causes=("large", "small"), explained_fraction=0.4)
    assert decide_verdict(numbers, CRITERIA).remark == (
        "The closest explanation, large with small, removes 40 % of the mean square "
        "misfit."
    )
    worse = replace(FOUND, explained_fraction=-0.1)
    assert decide_verdict(worse, CRITERIA).remark == ""


def test_remark_on_one_trial_states_the_probable_cause():
    remark = decide_verdict(replace(FOUND, trials=1), CRITERIA).remark
    assert remark.endswith("In this trial it would be wind (0.97).")


@pytest.mark.parametrize(
    ("before", "after", "share"),
    [
        # a trial with a large constant misfit has the weight of one
        ((40.0, 4.0, 4.0, 4.0), (40.0, 0.1, 0.1, 0.1), 0.75),
        # a single explained trial has the weight of one
        ((40.0, 4.0, 4.0, 4.0), (1.0, 4.0, 4.0, 4.0), 0.25),
        # trials within the tolerance are ignored
        ((4.0, 4.0, 1.0, 1.0), (0.1, 0.1, 1.5, 1.5), 1.0),
        # larger and smaller misfits have equal weight
        ((4.0, 1.0), (0.1, 4.0), 0.03),
        # if all are within the tolerance, the largest misfit is used
        ((1.0, 0.5), (0.5, 0.5), 0.75),
    ],
)
def test_trials_have_equal_weight_in_the_explained_fraction(before, after, share):
    misfit_m = np.array(before) / 1e3, np.array(after) / 1e3
    assert mean_explained_fraction(*misfit_m, 2e-3) == pytest.approx(share, abs=0.01)
