"""The page of a diagnosis is self-contained and correct for every verdict."""

import itertools
import json
import re
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from conftest import leave_pictures_empty
from matplotlib import style
from matplotlib.colors import to_hex
from matplotlib.text import Text

from stringcast.data.diagnoses import Diagnosis
from stringcast.stages.model.library import find_effects
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.report.charts import residual
from stringcast.stages.report.charts.axes import draw_map, new_axes
from stringcast.stages.report.charts.residual import (
    NEGATIVE_COLOUR,
    POSITIVE_COLOUR,
    residual_components,
    residual_maps,
)
from stringcast.stages.report.charts.string_film import tip_points, worst_frame
from stringcast.stages.report.formatting import (
    format_gain,
    format_percent,
    format_quantity,
    verdict_headline,
)
from stringcast.stages.report.pages.diagnosis import diagnosis_page
from stringcast.stages.report.records import (
    MAX_DRAWN_TRIALS,
    DiagnosisRecord,
    StageRecord,
    model_distances,
    trial_rms,
)
from stringcast.stages.report.theme import STYLE_SHEET
from tests.report.page_reader import Page, fixed_colours

SIGMA = 7e-4
S = np.linspace(0.05, 0.3, 6)
NAMED = {
    "tip_mass": (
        "a mass of 5.1 % of the string's sits at the tip",
        "ratio",
        "1",
        0.051,
        0.046,
        0.057,
    ),
    "arm_lag": (
        "the joints lag 12.0 ms behind",
        "time_constant",
        "s",
        0.012,
        0.0113,
        0.0127,
    ),
    "time_offset": (
        "the arm's clock is 12.0 ms ahead",
        "offset",
        "s",
        -0.012,
        -0.0127,
        -0.0113,
    ),
}
GAIN = {
    "held_out_trials": ["t00", "t01"],
    "rms_m": {"base": 0.0034, "extended": 0.0009, "noise_floor": 0.001},
    "tip_rms_m": {"base": 0.0061, "extended": 0.0013},
    "matching_rate": {"base": 0.71, "extended": 0.93},
    "log_likelihood_per_trial": {"difference": 81234.0, "standard_error": 90.0},
}

UNCERTAIN = {"intervals": {}, "correlations": []}


# --- a plausible diagnosis made by hand
def measured(off=0.004, trials=2, frames=30):
    """Return residuals of a straight, swinging string.

    The error of the base model to the right is `off` s/L, growing with time and trial.
    """
    rng = np.random.default_rng(1)
    t, s = (a.ravel() for a in np.meshgrid(np.arange(frames) * 0.01, S, indexing="ij"))
    tables = []
    for number in range(trials):
        angle = 3 * t - 1
        along = np.stack([np.cos(angle), np.sin(angle)])
        left = np.stack([-np.sin(angle), np.cos(angle)])
        noise = rng.normal(0, SIGMA, (2, len(t)))
        extended = s * along
        base = extended - (1 + number) * off * t / t.max() * s / S[-1] * left
        x, y = extended + noise
        table = {
            "trial": f"t{number:02d}",
            "t": t,
            "s": s,
            "x": x,
            "y": y,
            "sigma": SIGMA,
            "total_sigma": 1.2 * SIGMA,
        }
        table |= {
            "base_x": base[0],
            "base_y": base[1],
            "extended_x": extended[0],
            "extended_y": extended[1],
        }
        residual = np.array([x, y]) - base
        table |= {
            "base_normal": (residual * left).sum(axis=0),
            "base_tangential": (residual * along).sum(axis=0),
        }
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def unextended(table):
    return table.assign(extended_x=table["base_x"], extended_y=table["base_y"])


def caused(names, probability=0.97):
    rows = [
        {
            "effect": name,
            "probability": probability / len(names),
            "sentence": NAMED[name][0],
        }
        | {
            "parameter": f"{name}.{NAMED[name][1]}",
            "meaning": "what it is",
            "unit": NAMED[name][2],
            "at_least": False,
        }
        | dict(zip(("value", "low", "high"), NAMED[name][3:], strict=True))
        for name in names
    ]
    return pd.DataFrame(rows) if rows else Diagnosis.TABLES["causes"].empty()


def held_out():
    rows = [("t00", 0.003, 0.0009, 0.001, 0.005, 0.0012, 0.7, 0.93, 80000.0, 0.0009)]
    rows += [("t01", 0.004, 0.0010, 0.001, 0.007, 0.0014, 0.72, 0.93, 82468.0, 0.0010)]
    return pd.DataFrame(
        rows, columns=[c.name for c in Diagnosis.TABLES["held_out"].columns]
    )


def hypotheses(count=3):
    rows = [
        ("tip_mass", 9, 0.9, 56716.0, 65432.0, 0.0238, 0.004, 0.98),
        ("", 8, 9.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    ]
    rows += [
        (f"wind + other{n}", 11, 3.0, 100.0 + n, np.nan, 0.004, 0.5, 0.01)
        for n in range(count - 2)
    ]
    return pd.DataFrame(
        rows, columns=[c.name for c in Diagnosis.TABLES["hypotheses"].columns]
    )


def displaced():
    rows = [
        ("t01", t, s, 0.002 * t, -0.0034 if t == 0.1 else 0.0)
        for t in (0.0, 0.1, 0.2)
        for s in (0.1, 0.2)
    ]
    return pd.DataFrame(
        rows, columns=[c.name for c in Diagnosis.TABLES["missing"].columns]
    )


def make_diagnosis(verdict, names=(), sentence="So it is.", **tables):
    """Return a diagnosis with the usual content of its verdict; `tables` replace its own."""
    causes = caused(names)
    document = {
        "format": 1,
        "verdict": verdict,
        "alternatives": [{"effect": "unknown", "probability": 0.03}],
    }
    document["causes"] = causes.drop_duplicates("effect")[
        ["effect", "probability", "sentence"]
    ].to_dict("records")
    document["set_aside"] = [
        {"effect": "lens_distortion", "reason": "the trials do not agree on it"}
    ]
    document["not_tried"] = [{"effect": "box_contact", "reason": "it is an obstacle"}]
    document["indistinguishable"] = [list(names)] if verdict == "ambiguous" else []
    document |= {
        "base": {"parameters": {}, **UNCERTAIN},
        "extended": UNCERTAIN,
        "budget": [],
        "interrupted": False,
    }
    document |= {"gain": tables.pop("gain", GAIN)}
    document |= {"next_experiment": tables.pop("following", None)}
    document |= {
        "unexplained": {
            "fraction": 0.03,
            "where": "",
            "course": tables.pop("course", ""),
            "sentence": tables.pop("left", ""),
        }
    }
    document["clocks"] = {"offsets": {}, "sentence": tables.pop("clocks", "")}
    document |= {
        "trials": {
            "used": ["t00", "t01"],
            "rejected": tables.pop("rejected", {}),
            "points_left_out": {"outliers": 0},
        }
    }
    extended = f"effects: [{', '.join(names)}]\nstring: {{points: 17}}\nparameter_values: {{linear_drag: 0.37}}\n"
    row = {
        "verdict": verdict,
        "sentence": sentence,
        "diagnosis": json.dumps(document),
        "extended": extended,
    }
    own = {name: table.empty() for name, table in Diagnosis.TABLES.items()}
    own |= {
        "finding": pd.DataFrame([row]),
        "causes": causes,
        "held_out": held_out(),
        "hypotheses": hypotheses(),
    }
    own["residuals"] = measured() if names else unextended(measured())
    bars = [("", "tip_mass", 45088.0), ("", "wind", 12.0), ("tip_mass", "wind", 9.0)]
    own["screening"] = pd.DataFrame(
        bars, columns=["context", "effect", "predicted_gain"]
    )
    own["likeness"] = pd.DataFrame(
        [("wind", "tip_mass", 0.42)], columns=["effect", "other", "cosine"]
    )
    return Diagnosis(**own | tables)


def entry_rows():
    rows = [(1, "tip_mass", 56716.0, "t00", 9000.0, 0.1, 0.1, 0.004, 0.001)]
    rows += [
        (1, "tip_mass", 56716.0, "t01", 48000.0, t, 0.29, off, 0.001)
        for t, off in ((0.2, 0.003), (0.3, 0.0123))
    ]
    return pd.DataFrame(
        rows, columns=[c.name for c in Diagnosis.TABLES["entries"].columns]
    )


def nothing_tried():
    nothing = {
        name: Diagnosis.TABLES[name].empty() for name in ("screening", "likeness")
    }
    return nothing | {"hypotheses": hypotheses()[1:2]}


VERDICTS = {
    "none": lambda: make_diagnosis("none", **nothing_tried()),
    "effect": lambda: make_diagnosis("effect", ["tip_mass"], entries=entry_rows()),
    "pair": lambda: make_diagnosis("effect", ["tip_mass", "arm_lag"]),
    "ambiguous": lambda: make_diagnosis("ambiguous", ["arm_lag", "time_offset"]),
    "partial": lambda: make_diagnosis(
        "partial", ["tip_mass"], missing=displaced(), left="5.0 of 9.0 mm remain."
    ),
    "unknown": lambda: make_diagnosis(
        "unknown", missing=displaced(), left="What is left looks like a force."
    ),
    "insufficient": lambda: make_diagnosis(
        "insufficient",
        left="there is one trial only",
        gain={"held_out_trials": []},
        held_out=Diagnosis.TABLES["held_out"].empty(),
        rejected={"t05": "arm and camera overlap for 0.02 s only"},
    ),
}


@pytest.fixture(scope="module")
def model(arm, camera):
    return Model(String(0.3), arm, camera)


@pytest.fixture(scope="module")
def write(model):
    """Return a function that writes the page of a diagnosis."""
    origin = {
        "seed": 7,
        "code": {"commit": "0123456789abcdef"},
        "packages": {"numpy": "2"},
    }

    def written(diagnosis, **other):
        facts = {
            "name": "bench-7",
            "settings": {"diagnose": {"starts": 4}},
            "model": model,
        } | other
        return diagnosis_page(
            StageRecord(
                sentence=diagnosis.sentence,
                artifact=diagnosis,
                provenance=origin,
                **facts,
            )
        )

    return written


# of which the pages have all kinds of drawings
DRAWN = ("pair", "partial")


@pytest.fixture(scope="module")
def written(write):
    """Write the page of each verdict; most have pictures without drawings."""
    pages = {name: write(VERDICTS[name]()) for name in DRAWN}
    with pytest.MonkeyPatch.context() as patch:
        leave_pictures_empty(patch)
        for name in VERDICTS.keys() - pages.keys():
            pages[name] = write(VERDICTS[name]())
    return pages


@pytest.fixture(scope="module")
def pages(written):
    return {name: Page(page) for name, page in written.items()}


@pytest.fixture(scope="module")
def shared_panels():
    """Create the axes of maps once for each number of trials, because this is slow."""
    return cache(residual._map_panels)


@pytest.fixture
def page_of(write, undrawn, shared_panels, monkeypatch):
    """Return a function that renders and reads a page without drawings."""
    monkeypatch.setattr(residual, "_map_panels", shared_panels)
    return lambda *given, **facts: Page(write(*given, **facts))


def with_document(made, **parts):
    """Return a diagnosis with parts of its document replaced."""
    document = json.loads(made.finding["diagnosis"].iloc[0]) | parts
    return replace(made, finding=made.finding.assign(diagnosis=json.dumps(document)))


# --- every verdict
EXPECTED_TEXTS = {
    "none": [
        "The simulation agrees with the measurements",
        "No cause found",
        "below the tolerance",
    ],
    "effect": [
        "Found: tip mass",
        "A mass of 5.1 % of the string's sits at the tip.",
        "97 %",
        "0.051",
        "0.046 to 0.057",
        "The extended model adds tip mass",
        "81 234 ± 90",
        "0.710 to 0.930",
        "3.4 mm → 0.9 mm",
        "6.1 mm → 1.3 mm",
        "noise alone: 1.0 mm",
        "56 716",
        "65 432",
        "base model alone",
        "Order of the causes",
        "t01 48 000, t00 9 000",
        "t01, 0.30 s, 290 mm along the string",
        "12.3 mm → 1.0 mm",
        "Newton's second law",
        "leaves 3 % of the base model's misfit at the tip",
        "0.37",
        "seed 7",
    ],
    "pair": ["Found: tip mass, arm lag", "48 %", "12.0 ms", "11.3 to 12.7 ms"],
    "ambiguous": [
        "Undecided: arm lag or time offset",
        "do not distinguish arm lag and time offset",
        "−12.0 ms",
        "−12.7 to −11.3 ms",
    ],
    "partial": [
        "Partly explained. Found: tip mass",
        "they do not explain all of the misfit",
        "Excluded causes",
        "the trials do not agree on it",
        "5.0 of 9.0 mm remain.",
    ],
    "unknown": [
        "The simulation has an error of unknown cause",
        "What is left looks like a force.",
        "The longest is 3.4 mm",
        "No model was extended.",
        "a cause that the library does not contain",
    ],
    "insufficient": [
        "The data do not allow a diagnosis",
        "there is one trial only",
        "arm and camera overlap for 0.02 s only",
        "No trial was left out of the fit",
        "not known",
    ],
}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_has_texts_and_numbers_of_each_verdict(pages, verdict):
    page = pages[verdict]
    assert "So it is." in page.text
    for words in EXPECTED_TEXTS[verdict]:
        assert re.sub(r"\s+", " ", words) in page.text
    assert not re.search(r"\b(nan|inf|None|Undefined)\b", page.text)


def test_effects_of_the_configured_model_are_not_called_added(page_of, model):
    pair = VERDICTS["pair"]()
    assert "adds tip mass and arm lag" in page_of(pair).text
    with_lag = model.with_effects(*find_effects(["arm_lag"]))
    assert "adds tip mass and is" in page_of(pair, model=with_lag).text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_loads_nothing_from_elsewhere(pages, verdict):
    page = pages[verdict]
    page.require_complete()
    policy = next(m["content"] for m in page.all("meta") if "http-equiv" in m)
    own = r"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src( 'sha256-[\w+/=]+'){2}"
    assert re.fullmatch(own, policy)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_picture_has_a_description_and_follows_the_theme(pages, verdict):
    """Both ends of the colour scale are visible on light and dark pages."""
    scale = {to_hex(POSITIVE_COLOUR), to_hex(NEGATIVE_COLOUR)}
    for words, drawing in pages[verdict].drawings().items():
        assert len(words) > 30
        assert "nan" not in words
        assert fixed_colours(drawing) <= scale, words
        assert ("<path" in drawing) == (verdict in DRAWN)


@pytest.mark.parametrize(
    ("verdict", "count"), [("none", 2), ("effect", 5), ("pair", 7), ("unknown", 4)]
)
def test_page_has_the_drawings_of_its_verdict(pages, verdict, count):
    """A page has maps and residuals; with causes more maps, laws and predictions."""
    assert len(pages[verdict].all("img")) == count, [
        p["alt"] for p in pages[verdict].all("img")
    ]


def test_same_record_gives_the_same_page(write, written):
    assert write(VERDICTS["partial"]()) == written["partial"]


def test_data_cannot_become_code(page_of):
    evil = "</p><img src=x onerror=alert(1)>"
    made = make_diagnosis("none", sentence=evil, left=evil, rejected={evil: evil})
    page = page_of(made, name=evil, settings={evil: evil})
    assert not [a for _, a in page.elements if "onerror" in a]
    assert page.text.count(evil) >= 6


def test_the_time_course_of_the_misfit_is_shown(page_of):
    course = "The unexplained misfit grows over the trial in 1 of 2 trials."
    assert course in page_of(make_diagnosis("effect", ["tip_mass"], course=course)).text


def test_clocks_that_differ_are_stated(page_of):
    made = make_diagnosis("unknown", clocks="The clocks differ from trial to trial.")
    assert "The clocks differ from trial to trial." in page_of(made).text


def test_error_budget_is_shown(page_of):
    made = make_diagnosis("effect", ["tip_mass"])
    assert "Error budget" not in page_of(made).text
    unexplained = json.loads(made.finding["diagnosis"].iloc[0])["unexplained"]
    unexplained |= {
        "tip_rms_m": {"value": 0.0, "low": 0.0, "high": 1.1e-4},
        "tolerance_m": 0.002,
    }
    budget = [
        {"source": "tip_mass", "tip_rms_m": 0.00207, "log_evidence": 1570.9},
        {"source": "noise", "tip_rms_m": 0.0009},
    ]
    text = page_of(with_document(made, budget=budget, unexplained=unexplained)).text
    assert "Unexplained: 0.0 mm (0.0 mm to 0.1 mm, 95 %); tolerance: 2.0 mm." in text
    for words in ("tip mass 2.07 mm 1 571", "noise 0.90 mm"):
        assert words in re.sub(r"\s+", " ", text)


def test_intervals_of_parameters_and_correlation_of_lookalikes_are_shown(page_of):
    alike = pd.DataFrame(
        [("arm_lag", "time_offset", 0.9964)], columns=["effect", "other", "cosine"]
    )
    made = make_diagnosis("ambiguous", ["arm_lag", "time_offset"], likeness=alike)
    base = {
        "parameters": {"linear_drag": 0.3},
        "intervals": {"linear_drag": [0.28, 0.33]},
    }
    together = [{"parameters": ["linear_drag", "quadratic_drag"], "value": -0.854}]
    extended = {"intervals": {"linear_drag": [0.36, 0.38]}, "correlations": together}
    text = page_of(with_document(made, base=base, extended=extended)).text
    for words in (
        "These data do not distinguish arm lag and time offset (correlation 0.996).",
        "0.300 0.280 to 0.330 0.370 0.360 to 0.380 +23 %",
        "Correlated parameters: linear drag and quadratic drag (−0.85).",
    ):
        assert words in text


def test_cause_without_parameters_is_shown(page_of):
    causes = caused(["tip_mass"]).assign(
        effect="resolution", parameter="", value=np.nan, low=np.nan, high=np.nan
    )
    made = make_diagnosis(
        "effect", causes=causes, sentence="It has too few mass points."
    )
    page = page_of(made)
    assert "The maps are those of 17 mass points instead of 10" in page.text
    assert not re.search(r"\bnan\b", page.text)


def test_diagnosis_without_residuals_has_a_page(page_of):
    empty = {
        name: Diagnosis.TABLES[name].empty()
        for name in ("residuals", "hypotheses", "held_out")
    }
    nothing = {"gain": {"held_out_trials": []}, **nothing_tried(), **empty}
    page = page_of(make_diagnosis("insufficient", **nothing))
    assert "Nothing was measured that could be compared." in page.text
    assert page.all("img") == []


def test_interrupted_search_is_stated(page_of):
    left = "The search for causes was interrupted, when it had come to none."
    made = make_diagnosis("insufficient", left=left)
    said = page_of(with_document(made, interrupted=True)).text
    assert "No cause is named, because the search is incomplete." in said
    assert "do not allow a diagnosis" not in said
    assert "requires more data" not in said


def test_search_is_described_only_if_there_was_one(page_of):
    said = page_of(
        make_diagnosis("unknown", left="What is left looks like a force.")
    ).text
    assert "too small for a search" not in said
    assert "The effect with the most evidence is added" in said
    assert "without the strongest trial" in said


def test_texts_on_a_map_do_not_overlap(model, monkeypatch):
    """Names of trials may be longer than the height of a row."""
    monkeypatch.setattr(
        sys.modules[residual_maps.__module__], "svg_picture", lambda figure, alt: figure
    )
    names = {
        "t00": "drive_black_short_unweighted",
        "t01": "release_black_short_unweighted",
    }
    table = measured().replace({"trial": names})
    with style.context(STYLE_SHEET):
        figure = residual_maps(
            DiagnosisRecord(
                make_diagnosis("effect", ["tip_mass"], residuals=table), model
            ),
            "base",
        )
        figure.draw_without_rendering()
    words = [
        text for text in figure.findobj(Text) if text.get_text() and text.get_visible()
    ]
    boxes = {
        text.get_text(): text.get_window_extent()
        for text in words
        if not re.fullmatch(r"[−\d.]+", text.get_text())
    }
    assert set(names.values()) < set(boxes)
    for one, other in itertools.combinations(boxes.values(), 2):
        assert not one.overlaps(other)


def test_worst_trials_and_best_hypotheses_are_shown(page_of):
    many = {"residuals": measured(trials=MAX_DRAWN_TRIALS + 4)}
    page = page_of(
        make_diagnosis("effect", ["tip_mass"], hypotheses=hypotheses(40), **many)
    )
    drawn = {a["aria-label"].split()[4] for tag, a in page.elements if tag == "canvas"}
    assert drawn == {f"t{number:02d}" for number in range(4, MAX_DRAWN_TRIALS + 4)}
    assert (
        page.text.index("base model alone")
        < page.text.index("28 more")
        < page.text.index("wind + other5 ")
    )


def test_probable_hypothesis_is_always_shown(page_of):
    table = hypotheses(40)
    is_found = table["causes"] == "tip_mass"
    table.loc[is_found, "fit_gain"] = 50.0
    table.loc[table["causes"] == "wind + other5", "probability"] = np.nan
    page = page_of(make_diagnosis("effect", ["tip_mass"], hypotheses=table))
    hidden = page.text.index("27 more")
    start = page.text.index("Fitted hypotheses")
    assert start < page.text.index("tip mass", start) < hidden
    assert "50 % " in page.text[page.text.index("wind + other5 ") :]


def test_unknown_cause_is_named_as_an_addition(page_of):
    named = page_of(make_diagnosis("effect", ["tip_mass"])).text
    assert "in addition, a cause that the library does not contain" in named
    unnamed = page_of(make_diagnosis("unknown", [])).text
    assert "in addition, a cause" not in unnamed


# --- truth of the pictures
def test_only_a_distinguishable_cause_is_marked_as_likely(page_of):
    def marks(verdict, names):
        causes = caused(names, probability=0.6 * len(names))
        page = page_of(make_diagnosis(verdict, names, causes=causes))
        classes = [a.get("class", "").split() for _, a in page.elements]
        return sum("badge" in each and "good" in each for each in classes)

    assert marks("effect", ["tip_mass"]) == 1
    assert marks("ambiguous", ["arm_lag", "time_offset"]) == 0


def test_cells_of_a_map_end_with_the_string():
    t = np.repeat(np.arange(3) * 0.01, 2)
    for s in ([0.16, 0.32], [0.32, 0.32]):
        _, axes = new_axes(1.0, 1.0)
        draw_map(axes, np.tile(s, 3), t, np.ones(6), 0.32)
        assert axes.get_ylim() == pytest.approx((axes.get_ylim()[0], 320.0))


def test_residual_components_agree_with_the_table():
    table = measured()
    base = residual_components(table, "base")
    extended = residual_components(table, "extended")
    np.testing.assert_allclose(base["normal"], table["base_normal"] / SIGMA)
    np.testing.assert_allclose(base["tangential"], table["base_tangential"] / SIGMA)
    np.testing.assert_allclose(
        np.hypot(*extended.values()), model_distances(table, "extended") / SIGMA
    )
    assert base["normal"].mean() > 1, (
        "the base model lies to the right, so the measured string is to its left"
    )
    assert np.abs(extended["normal"]).max() < 5


def test_residual_components_of_a_zero_residual():
    table = measured().assign(base_normal=0.0, base_tangential=0.0)
    met = table.assign(x=table["base_x"], y=table["base_y"])
    assert all(
        np.all(np.isfinite(part))
        for part in residual_components(met, "extended").values()
    )
    assert not np.any(residual_components(met, "base")["normal"])


def test_worst_frame_ignores_outliers():
    table = measured(off=0.02, trials=1)
    table.loc[(table["t"] == 0) & (table["s"] == S[2]), "x"] += 0.5
    assert worst_frame(table)["t"].iloc[0] > 0.25
    assert list(worst_frame(table)["s"]) == list(S)


def test_frames_without_a_tip_are_omitted_from_its_path():
    table = measured(trials=1)
    hidden = table[~((table["t"] == 0.1) & (table["s"] > 0.2))]
    ends = tip_points(hidden)
    assert 0.1 not in set(ends["t"])
    assert set(ends["s"]) == {S[-1]}


def test_rms_of_noise_is_the_noise_floor():
    """The rms is over both coordinates; 360 of them scatter by 4 %."""
    assert trial_rms(measured(), "extended").to_numpy() == pytest.approx(
        np.sqrt(2) * SIGMA, rel=0.15
    )


# --- wording
@pytest.mark.parametrize(
    ("unit", "value", "low", "high", "at_least", "words", "between"),
    [
        (
            "s",
            -0.00058,
            -0.000592,
            -0.000569,
            False,
            "−0.580 ms",
            "−0.592 to −0.569 ms",
        ),
        ("m", 0.0123, 0.0119, 0.0127, False, "12.30 mm", "11.90 to 12.70 mm"),
        (
            "rad",
            np.radians(2.5),
            np.radians(1.9),
            np.radians(3.1),
            False,
            "2.5 °",
            "1.9 to 3.1 °",
        ),
        ("1", 0.051, 0.046, 0.057, False, "0.051", "0.046 to 0.057"),
        ("1/m", 12.0, 2.0, 22.0, False, "12 1/m", "2 to 22 1/m"),
        (
            "1/s2",
            5.5e5,
            np.nan,
            np.nan,
            False,
            "5.5 × 10⁵ 1/s<sup>2</sup>",
            "not known",
        ),
        (
            "1/s2",
            5.5e5,
            2.1e5,
            1e7,
            True,
            "5.5 × 10⁵ 1/s<sup>2</sup>",
            "at least 2.1 × 10⁵ 1/s<sup>2</sup>",
        ),
    ],
)
def test_values_have_as_many_figures_as_their_interval_justifies(
    unit, value, low, high, at_least, words, between
):
    row = {"unit": unit, "value": value, "low": low, "high": high, "at_least": at_least}
    assert format_quantity(row) == (words, between)


def test_shares_and_gains_are_readable():
    assert [format_percent(p) for p in (0.0, 0.004, 0.58, 0.9994, 1.0)] == [
        "under 1 %",
        "under 1 %",
        "58 %",
        "over 99 %",
        "100 %",
    ]
    assert [format_gain(v) for v in (719887.3, -12.0, np.nan)] == [
        "719\u202f887",
        "−12",
        "not known",
    ]


def test_certain_cause_in_addition_to_lookalikes():
    causes = [{"effect": name} for name in ("wind", "arm_lag", "time_offset")]
    document = {
        "verdict": "ambiguous",
        "interrupted": False,
        "causes": causes,
        "indistinguishable": [["arm_lag", "time_offset"]],
    }
    assert (
        verdict_headline(document) == "Found: wind. Undecided: arm lag or time offset"
    )


def predicted(off=0.005):
    """Return a straight string under two hypotheses, which differ at the tip at 0.2 s.

    off: difference [m].
    """
    t, s = (a.ravel() for a in np.meshgrid([0.0, 0.1, 0.2], S, indexing="ij"))
    away = np.where((t == 0.2) & (s == S[-1]), off, 0.0)
    common = {"t": t, "s": s, "x": s, "sigma": SIGMA}
    return pd.concat(
        [pd.DataFrame({"hypothesis": "arm_lag", **common, "y": 0.0})]
        + [pd.DataFrame({"hypothesis": "time_offset", **common, "y": away})]
    )


def test_proposed_motion_is_shown_where_hypotheses_differ_most(page_of):
    alike = ["arm_lag", "time_offset"]
    following = {"sentence": "One of 300 motions tells them apart."}
    made = make_diagnosis(
        "ambiguous", alike, following=following, predicted=predicted()
    )
    page = page_of(made)
    assert following["sentence"] in page.text
    words = " ".join(image["alt"] for image in page.all("img"))
    assert "The proposed motion at 200" in words
    assert "time offset 5.0" in words
    made = make_diagnosis("ambiguous", alike, following={"sentence": "No motion."})
    hopeless = page_of(made)
    assert "No motion." in hopeless.text
    assert not any("proposed" in image["alt"] for image in hopeless.all("img"))
    assert "Next experiment" not in page_of(VERDICTS["effect"]()).text


def test_trial_predicted_worse_with_causes_is_reported(page_of):
    """A cause that only one trial shows looks like a false cause, so both are named."""
    table = held_out()

    def text(**columns):
        made = make_diagnosis("effect", ["tip_mass"], held_out=table.assign(**columns))
        return page_of(made).text

    worse = {"rms_extended": [0.0537, 0.0010]}
    said = text(**worse)
    assert (
        "t00 is predicted worse with the causes than without, 53.7 mm against 3.0 mm. After fitting it as well"
        in said
    )
    assert "or the causes are wrong" in said
    assert "(worse for t00: see below)" in said
    unexplained = text(**worse, rms_known=[0.0029, 0.0010])
    assert "t00 is predicted worse" in unexplained
    assert "After fitting it as well" not in unexplained
    for columns in ({}, {"rms_extended": [0.0031, 0.0010]}):
        assert "worse" not in text(**columns)


def test_page_states_which_trials_the_gain_refers_to(page_of):
    """They were held out, or left out of the fit in turn; an unknown rate has no number."""
    turn = page_of(make_diagnosis("effect", ["tip_mass"])).text
    assert "Each trial was predicted by both models fitted to the others." in turn
    assert "chosen from all trials" in turn
    unknown = {"matching_rate": {"base": None, "extended": None}}
    told = GAIN | {"held_out_trials": ["t07"]} | unknown
    aside = page_of(make_diagnosis("effect", ["tip_mass"], gain=told)).text
    assert (
        "These trials were excluded from the search and predicted by both models fitted to the others."
        in aside
    )
    assert "chosen from all trials" not in aside
    assert "E changes from not known to not known" in aside
