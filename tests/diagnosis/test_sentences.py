"""Ends of ranges, and sentences on look-alikes and on the remaining misfit."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from stringcast.stages.diagnose import summary
from stringcast.stages.diagnose.results import document, tables
from stringcast.stages.diagnose.results.document import verdict_sentences
from stringcast.stages.diagnose.rules import is_inside_range
from stringcast.stages.diagnose.verdict import Verdict
from stringcast.stages.inference.discrepancy_grid import (
    COURSE_COUNT,
    DISCREPANCY_SCALES_M,
)
from stringcast.stages.model.library import effects_by_name


@pytest.mark.parametrize(
    ("name", "chi", "is_inside"),
    [
        ("wind", (0.0, 0.4), False),
        ("wind", (0.0, 1.0), False),
        ("wind", (0.01, 0.4), True),
        ("tip_mass", (1.0,), False),
        ("tip_mass", (0.0,), True),  # absent
        # a stiffness is only a lower bound; friction and loss are not amplitudes
        ("contact", (1.0, 0.5, 0.5, 1.0, 1.0), True),
        # a string at rest sinks 20 mm into it, or 5 mm
        ("contact", ((490 / 1e7) ** 0.5, 0.5, 0.5, 0.5, 0.5), False),
        ("contact", ((1960 / 1e7) ** 0.5, 0.5, 0.5, 0.5, 0.5), True),
    ],
)
def test_an_amplitude_at_an_end_of_its_range_is_not_a_finding(name, chi, is_inside):
    effect = effects_by_name()[name]
    indices = {p.name: k for k, p in enumerate(effect.parameters)}
    start = np.array([float(p.chi(np.asarray(p.start))) for p in effect.parameters])
    hypothesis = SimpleNamespace(
        parameter_indices=lambda cause, some: [indices[p.name] for p in some],
        exponents_from=lambda known: start,
    )
    fit = SimpleNamespace(hypothesis=hypothesis, chi=np.array(chi))
    assert is_inside_range(fit, effect) == is_inside


PLACE = (
    "most of it in trial b (20.0 mm there, 100 % of the whole), largest at 0.20 s, "
    "0.30 m along the string."
)
LATE = 3 * len(DISCREPANCY_SCALES_M)  # a grid point that begins in the middle
CONSTANT = (COURSE_COUNT - 1) * len(DISCREPANCY_SCALES_M)  # of constant size


@pytest.mark.parametrize(
    ("budget_m", "kind", "grid_point", "sentence"),
    [
        (
            (0.0, 0.0, 0.03),
            "unknown",
            0,
            f"A misfit of 14.1 mm is left at the tip; {PLACE}",
        ),
        (
            (0.02, 0.0, 0.03),
            "partial",
            0,
            f"14.1 of 14.1 mm remain unexplained at the tip; {PLACE}",
        ),
        (
            (0.013, 0.01, 0.03),
            "partial",
            LATE,
            "13.0 of 14.1 mm remain unexplained at the tip; "
            + PLACE.replace("largest", "from 0.15 s on, largest"),
        ),
    ],
)
def test_the_stated_misfit_is_that_of_the_budget_if_it_is_certainly_positive(
    monkeypatch, budget_m, kind, grid_point, sentence
):
    """The budget's share may be 0 if numerical error could explain the misfit."""
    trials = []
    for name in ("a", "b"):
        trial = SimpleNamespace(
            name=name,
            sigma=np.full(2, 1e-3),
            times=np.array([0.1, 0.2]),
            frame=np.array([0, 1]),
            s=np.array([0.3, 0.3]),
        )
        trials.append(trial)
    data = SimpleNamespace(trials=trials)
    discrepancy = [np.zeros(4), np.array([0.0, 0.0, 30.0, 0.0])]
    monkeypatch.setattr(
        document, "unexplained_tip_rms", lambda *_: np.array([0.0, 0.02])
    )
    monkeypatch.setattr(document, "mean_discrepancy", lambda *_: discrepancy)
    judgement = SimpleNamespace(
        verdict=SimpleNamespace(kind=kind, remark="", misfit_probability=1.0),
        base_fit=None,
    )
    found = document.unexplained_document(
        data,
        SimpleNamespace(grid_points=np.full(2, grid_point)),
        judgement,
        SimpleNamespace(unexplained_m=budget_m),
        SimpleNamespace(tip_tolerance_m=1e-3),
    )
    assert found["sentence"] == sentence


@pytest.mark.parametrize("misfit_probability", [0.0, 1.0])
def test_the_time_course_is_stated_only_if_misfit_remains(
    misfit_probability, monkeypatch
):
    monkeypatch.setattr(document, "unexplained_tip_rms", lambda *_: np.array([1e-4]))
    monkeypatch.setattr(document, "_largest_misfit_sentence", lambda *_: "late")
    found = document.unexplained_document(
        None,
        SimpleNamespace(grid_points=np.array([1])),
        SimpleNamespace(
            verdict=Verdict("effect", misfit_probability, ("wind",)), base_fit=None
        ),
        SimpleNamespace(unexplained_m=(1e-4, 0.0, 2e-4)),
        SimpleNamespace(tip_tolerance_m=2e-3),
    )
    course = "The unexplained misfit grows over the trial in 1 of 1 trials."
    assert found["course"] == (course if misfit_probability else "")


@pytest.mark.parametrize(
    ("grid_points", "sentence"),
    [
        ([0, 0], ""),
        ([1, 0], "The unexplained misfit grows over the trial in 1 of 2 trials."),
        (
            [LATE + 1, CONSTANT + 1, CONSTANT + 2, 3],
            "The unexplained misfit grows over the trial in 1 of 4 trials, begins "
            "during the trial in 1 and has the same size at all times in 2.",
        ),
    ],
)
def test_the_time_course_of_the_misfit_is_stated(grid_points, sentence):
    assert document._course_sentence(np.array(grid_points)) == sentence


def test_look_alikes_have_readable_names():
    """Names of effects have underscores."""
    names = ("maxwell_slip", "dahl_friction")
    verdict = Verdict("ambiguous", 0.0, names, lookalike_groups=(names,))
    judgement = SimpleNamespace(
        verdict=verdict, inclusion_probability=dict.fromkeys(names, 0.5)
    )
    causes = pd.DataFrame({"effect": names, "sentence": ["it slips", "it rubs"]})
    assert verdict_sentences(judgement, causes, "Little is left.") == [
        "These trials cannot distinguish maxwell slip and dahl friction: "
        "either it slips (probability 0.50), or it rubs (probability 0.50).",
        "Little is left.",
    ]


def test_the_remaining_misfit_is_stated_first_if_causes_explain_a_part():
    judgement = SimpleNamespace(
        verdict=Verdict("partial", 1.0, ("wind",)), inclusion_probability={"wind": 0.9}
    )
    causes = pd.DataFrame({"effect": ["wind"], "sentence": ["air flows"]})
    assert verdict_sentences(judgement, causes, "74 of 76 mm remain.") == [
        "74 of 76 mm remain.",
        "Cause of a part of the misfit: air flows (probability 0.90).",
    ]


@pytest.mark.parametrize(
    ("causes", "base_m", "addition"),
    [
        (
            [{"effect": "wind"}],
            0.0045,
            " Trials that were left out of the fit are predicted to 1.1 mm rms, and to "
            "4.5 mm without causes (noise 1.0 mm).",
        ),
        ([{"effect": "wind"}], None, ""),  # no trial could be left out
        ([], 0.0045, ""),  # both models are the same
    ],
)
def test_the_terminal_states_the_gain_if_it_is_known(causes, base_m, addition):
    sizes = {"base": base_m, "extended": 0.00112, "noise_floor": 0.001}
    known = {"causes": causes, "gain": {"rms_m": sizes}, "interrupted": False}
    diagnosis = SimpleNamespace(
        verdict="effect",
        sentence="A cause.",
        document=known,
        causes=pd.DataFrame(),
    )
    assert summary(diagnosis).sentence == f"A cause.{addition}"
    assert summary(diagnosis).title == "Cause found"

    known["interrupted"] = True
    assert summary(diagnosis).title == "Search interrupted"


@pytest.mark.parametrize(
    ("along_x", "along_y", "is_replaceable"),
    [
        ((0.4, 0.6), (-0.1, 0.1), False),
        ((-0.6, -0.4), (0.1, 0.2), False),
        ((-0.1, 0.6), (-0.1, 0.1), True),
        ((0.0, 0.6), (0.0, 0.1), True),
    ],
)
def test_a_cause_whose_interval_contains_none_may_be_replaced(
    along_x, along_y, is_replaceable, monkeypatch
):
    """The probability is that of some cause there; small others may share its effect."""
    intervals = {"wind.along_x": along_x, "wind.along_y": along_y}
    middle = {name: sum(ends) / 2 for name, ends in intervals.items()}
    fit = SimpleNamespace(
        values=middle,
        cause_parameters=lambda effect: {k[5:]: v for k, v in middle.items()},
    )
    monkeypatch.setattr(tables, "fit_containing", lambda *_: fit)
    monkeypatch.setattr(
        tables, "parameter_uncertainty", lambda *_: {"intervals": intervals}
    )
    data = SimpleNamespace(between_trial_tip_rms=lambda name: 0.0)
    state = SimpleNamespace(prepared=SimpleNamespace(data=data))
    judgement = SimpleNamespace(
        verdict=Verdict("effect", 0.0, ("wind",)),
        inclusion_probability={"wind": 1.0},
        background=(),
    )
    causes = tables.causes_table(state, judgement, 1.96)
    said = causes["sentence"].str.endswith(
        "small amounts of other effects may replace it"
    )
    assert list(said) == [is_replaceable] * 2
