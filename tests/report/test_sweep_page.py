"""The page of a sweep: means and intervals by hand, factors and failures."""

import base64
import re
import warnings

import numpy as np
import pandas as pd
import pytest

from stringcast.pipeline.settings.setting_comments import setting_units
from stringcast.stages.report.charts.sweep import outcome_curve
from stringcast.stages.report.outcomes import (
    CAST_OUTCOMES,
    arithmetic_mean,
    geometric_mean,
    mean_response,
    mean_share,
    parameter_outcome,
)
from stringcast.stages.report.pages.sweep import sweep_page
from stringcast.stages.report.records import SweepRecord

BETA = "estimate.beta"
HIT, CASTS, E = CAST_OUTCOMES[:3]
STIFFNESS = ("bending_stiffness", "N m/(rad kg)")


def swept(betas=(0.99, 0.995), targets=("near", "far"), seeds=(0, 1, 2, 3)):
    """Return a table of jobs in which E grows with beta by 20 and far is never hit."""
    rng = np.random.default_rng(0)
    rows = []
    for beta in betas:
        for target in targets:
            for seed in seeds:
                row = {
                    "job": len(rows),
                    "key": f"k{len(rows):02d}",
                    "folder": f"k{len(rows):02d}",
                    "state": "done",
                }
                row |= {
                    "error": "",
                    "attempts": 1,
                    "seconds": 2.0,
                    "host": "here",
                    "hit": float(target == "near"),
                }
                row |= {
                    "casts": 1.0 + seed,
                    "E_before": 0.5,
                    "E_after": 0.7 + 20 * (beta - 0.99),
                }
                row |= {
                    "miss_m": 0.01 * rng.random(),
                    "experiment": "x",
                    BETA: beta,
                    "target": target,
                    "seed": seed,
                }
                rows.append(row | {STIFFNESS[0]: 10.0 ** rng.normal()})
    return pd.DataFrame(rows)


def record(table, given=("experiment", BETA, "target", "seed")):
    origin = {"seed": "of each job", "code": {"commit": "0123456789abcdef"}}
    estimated = dict([STIFFNESS])
    return SweepRecord(
        "demo", "all done", table, given, estimated, {"max_casts": "5"}, origin, {}
    )


def test_intervals_are_those_of_textbooks():
    """Student's t for 1, 2, 3 gives 2 -+ 4.303 / sqrt 3.

    Wilson's for 8 of 10 is 0.490 to 0.943 (Newcombe 1998).
    """
    assert arithmetic_mean(np.array([1.0, 2.0, 3.0])) == pytest.approx(
        (2.0, 2 - 2.4843, 2 + 2.4843), abs=1e-3
    )
    assert mean_share(np.array([1.0] * 8 + [0.0] * 2)) == pytest.approx(
        (0.8, 0.490, 0.943), abs=1e-3
    )
    assert geometric_mean(np.array([0.1, 1.0, 10.0]))[0] == pytest.approx(1.0)
    assert np.isnan(arithmetic_mean(np.array([1.0]))[1:]).all()


def test_hit_rate_of_0_or_1_has_an_interval():
    assert mean_share(np.ones(3))[1] < 0.5
    assert mean_share(np.zeros(3))[2] > 0.5


def test_seeds_count_as_repetitions_and_jobs_do_not():
    """Ten jobs of one seed count as one value, their mean."""
    table = swept(np.linspace(0.9, 0.99, 10), targets=("near",), seeds=range(5))
    whole = mean_response(table, CASTS, ["target"]).iloc[0]
    assert (whole["seeds"], whole["jobs"]) == (5, 50)
    assert whole["mean"] == pytest.approx(3.0)
    # Student's interval of values 1 to 5, with four degrees of freedom
    half = 2.776 * np.sqrt(2.5 / 5)
    assert whole["high"] - whole["mean"] == pytest.approx(half, rel=1e-3)
    few = mean_response(table[table["seed"] < 4], CASTS, ["target"]).iloc[0]
    assert few["mean"] == pytest.approx(2.5)
    assert np.isnan([few["low"], few["high"]]).all()


def test_intervals_are_clipped_to_possible_values():
    """Clipping does not change how often the interval covers the mean."""
    by_name = {outcome.name: outcome for outcome in CAST_OUTCOMES}
    _, low, high = by_name["E_after"].mean_over_seeds(np.array([0.1, 1, 1, 1, 1.0]))
    assert (low > 0, high) == (True, 1.0)
    values = np.array([0.0, 0.0, 0.0, 0.0, 0.2])
    mean, low, high = by_name["miss_m"].mean_over_seeds(values)
    assert (mean, low) == (pytest.approx(40.0), 0.0)
    assert high == pytest.approx(40 + 2.776 * 40, rel=1e-3)
    assert by_name["casts"].mean_over_seeds(np.array([1, 1, 1, 1, 2.0]))[1] == 1

    rng = np.random.default_rng(0)
    expected = 54.17  # [mm], mean of a normal distribution without its negative part
    covered, covered_without_ends = 0, 0
    for _ in range(400):
        draws = np.clip(rng.normal(0.05, 0.05, 5), 0, None)
        _, low, high = by_name["miss_m"].mean_over_seeds(draws)
        covered += low <= expected <= high
        _, low, high = np.array(arithmetic_mean(draws)) * 1e3
        covered_without_ends += low <= expected <= high
    assert covered == covered_without_ends
    assert covered / 400 > 0.9  # such skewed values fall slightly short of 95 %


def test_response_is_the_mean_over_other_settings():
    table = swept()
    at = mean_response(table, HIT, [BETA]).set_index(BETA)["mean"]
    assert at.to_dict() == pytest.approx({0.99: 50.0, 0.995: 50.0})
    assert mean_response(table, HIT, ["target"]).set_index("target")[
        "mean"
    ].to_dict() == {"far": 0.0, "near": 100.0}
    assert mean_response(table, E, [BETA])["mean"].diff().iloc[1] == pytest.approx(0.1)
    # zero has no logarithm
    table[STIFFNESS[0]] = np.where(table["seed"] == 0, 0.0, 10.0)
    assert mean_response(table, parameter_outcome(*STIFFNESS), [BETA])[
        "mean"
    ].to_list() == pytest.approx([10.0, 10.0])


def test_page_shows_each_factor():
    page = sweep_page(record(swept(seeds=range(5))))
    for factor in (BETA, "target"):
        assert f"<h2>Response to {factor}</h2>" in page
    assert "Response to experiment" not in page
    assert "Response to seed" not in page
    # pictures of hit, casts, E, miss and stiffness, and three maps
    assert page.count("<img alt=") == 2 * 5
    assert "20 of 20" in page
    assert re.search(
        r"hit rate % over target: 0 \(.*\) at far, 100 \(.*\) at near",
        page.replace("[%]", "%"),
    )
    for forbidden in ("http://", "https://", "<script", "nan"):
        assert forbidden not in page.replace("http://www.w3.org", "")
    assert page == sweep_page(record(swept(seeds=range(5))))
    drawn = base64.b64decode(
        re.search(r'alt="hit rate [^"]*estimate.beta[^"]*" src="[^,]*,([^"]*)', page)[1]
    ).decode()
    assert {">0.99</text>", ">0.995</text>"} <= set(
        re.findall(r">[\d.]+</text>", drawn)
    )


def heading(page):
    return re.search(r"<h1[^>]*>(.*?)</h1>", page, re.DOTALL)[1].strip()


def test_heading_states_the_largest_effect(undrawn):
    """Near is always hit and far never, whatever beta is.

    With five seeds, Wilson's intervals are 0.57 to 1 and 0 to 0.43. With four seeds
    there is no interval and no heading.
    """
    seeds = range(5)
    assert heading(sweep_page(record(swept()))) == "all done"
    assert (
        heading(sweep_page(record(swept(seeds=seeds))))
        == "The hit rate is 100 % with target=near, 0 % with far"
    )
    same = swept(targets=("near",), seeds=seeds)
    assert (
        heading(sweep_page(record(same)))
        == "The matching rate E is 0.8 with estimate.beta=0.995, 0.7 with 0.99"
    )
    nothing = "No varied setting changes the hit rate significantly"
    assert heading(sweep_page(record(same.assign(E_after=0.7)))) == nothing
    assert heading(sweep_page(record(swept().assign(state="pending")))) == "all done"


def test_failed_jobs_are_listed_and_excluded_from_means(undrawn):
    table = swept()
    table.loc[0, ["state", "error", "hit", "E_after"]] = [
        "failed",
        "the <string> is too short",
        np.nan,
        np.nan,
    ]
    shown = record(table)
    assert len(shown.finished_jobs) == 15
    page = sweep_page(shown)
    assert "15 of 16" in page
    assert "the &lt;string&gt; is too short" in page


@pytest.mark.parametrize("state", ["failed", "pending"])
def test_sweep_without_finished_jobs_has_a_page(state, undrawn):
    page = sweep_page(record(swept().assign(state=state)))
    assert "0 of 16" in page
    assert "No job is finished" in page


def test_one_setting_one_seed_and_no_casts(undrawn):
    table = (
        swept(targets=("near",), seeds=(0,))
        .drop(columns="seed")
        .assign(hit=np.nan, miss_m=np.nan)
    )
    page = sweep_page(record(table, ("experiment", BETA)))
    assert "fewer than 5 seeds hardly show the scatter" in page
    assert "hit rate" not in page.split("<section", 1)[1]


def test_equal_values_are_drawn_without_a_warning():
    """Rounding of the mean must not become the range of a logarithmic axis."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sweep_page(record(swept().assign(**{STIFFNESS[0]: 1e-3})))


def jobs_by_target():
    """Return jobs of three targets with two seeds each.

    One is hit in casts 1 and 3, one is never hit, and the jobs of one failed.
    """
    rows = [
        (0.1, 0, "done", 1.0, 1.0),
        (0.1, 1, "done", 1.0, 3.0),
        (0.4, 0, "done", 0.0, 5.0),
        (0.4, 1, "done", 0.0, 5.0),
        (0.7, 0, "failed", np.nan, np.nan),
        (0.7, 1, "failed", np.nan, np.nan),
    ]
    named = pd.DataFrame(rows, columns=["target.x", "seed", "state", "hit", "casts"])
    return (
        swept(betas=(0.99,), targets=("near",), seeds=range(6))
        .drop(columns=["target", "seed"])
        .assign(**named)
    )


def test_target_map_shows_the_outcome_of_each_target(undrawn):
    table = pd.concat(
        [jobs_by_target().assign(**{"target.y": y}) for y in (0.2, 0.5)],
        ignore_index=True,
    )
    page = sweep_page(record(table, ("target.x", "target.y", "seed")))
    assert "Targets" in page
    assert (
        "Of 6 targets 2 were hit, 2 in the first cast; 2 were not, 2 did not run."
        in page
    )
    twice = pd.concat([table.assign(specimen=name) for name in "AB"], ignore_index=True)
    page = sweep_page(record(twice, ("specimen", "target.x", "target.y", "seed")))
    # in alt and caption of each string's map
    assert page.count("Of 6 targets") == 2 * 2
    assert "Targets" not in sweep_page(record(swept()))


def test_axes_name_the_units_of_settings():
    made = outcome_curve(swept(), E, BETA, {BETA: "m/s"})
    assert f"{BETA} [m/s]" in base64.b64decode(made.source.partition(",")[2]).decode()
    assert setting_units(["target.x", "string.points", "name", BETA]) == {
        "target.x": "m"
    }
