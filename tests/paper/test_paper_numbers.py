"""The paper's numbers.

They are complete, with their places, and include those that the configuration takes
from the paper.
"""

import pandas as pd
import pytest
import yaml
from hydra.utils import get_object

from stringcast.pipeline.paper.finish import finish
from stringcast.pipeline.paper.scores import printed_values, read_printed_numbers
from stringcast.pipeline.settings.composition import (
    CONF_FOLDER,
    UserError,
    compose_settings,
)
from stringcast.pipeline.sweep.launcher import LedgerLauncher
from stringcast.stages.model.string import String
from stringcast.stages.report.records import EXPERIMENT_LABELS

PAPER = CONF_FOLDER / "experiment" / "paper.yaml"
EXPERIMENTS = [name for name in EXPERIMENT_LABELS if name != "nine"]
SYMBOLS = {p.name: p.symbol for p in String(0.3, points=10).parameters}


def test_every_number_stands_once_with_a_place():
    table = read_printed_numbers()
    assert len(table) == 51
    assert not table.duplicated(["what", "of"]).any()
    assert (table[["unit", "place"]] != "").all(axis=None)
    assert (table["value"] > 0).all()


def test_table_3_is_what_is_searched():
    ranges = compose_settings(["string=paper"])["string"]["ranges"]
    assert printed_values("minimum") == {
        SYMBOLS[name]: block["low"] for name, block in ranges.items()
    }
    assert printed_values("maximum") == {
        SYMBOLS[name]: block["high"] for name, block in ranges.items()
    }
    assert all(block["start"] == block["low"] for block in ranges.values())


def test_table_4_contradicts_table_3_where_the_page_says_so_and_nowhere_else():
    low, high = printed_values("minimum"), printed_values("maximum")
    columns = ("initial", "string A", "string B", "string C")
    outside = {
        (what, name)
        for what in columns
        for name, v in printed_values(what).items()
        if not low[name] <= v <= high[name]
    }
    assert outside == {("initial", "c_h"), ("initial", "c_ph"), ("string A", "k_ph")}


def test_the_ranges_of_table_4_hold_it_and_begin_with_its_initial_values():
    ranges = {
        SYMBOLS[name]: block
        for name, block in compose_settings(["string=table_4"])["string"][
            "ranges"
        ].items()
    }
    for name, start in printed_values("initial").items():
        assert ranges[name]["start"] == start
        assert all(
            ranges[name]["low"]
            <= printed_values(f"string {s}")[name]
            <= ranges[name]["high"]
            for s in "ABC"
        )


def test_units_are_the_same_in_both_tables():
    table = read_printed_numbers()
    units = (
        table[table["place"].isin(["Table 3", "Table 4"])]
        .groupby("of")["unit"]
        .nunique()
    )
    assert (units == 1).all()
    assert len(units) == 8


def test_settings_are_those_of_the_paper():
    table = read_printed_numbers().set_index(["what", "of"])["value"]
    config = compose_settings(["+experiment=stringB"])
    pairs = {
        ("beta", "estimation"): config["estimate"]["beta"],
        ("chi_0", "estimation"): config["estimate"]["chi_0"],
        ("delta_w", "estimation"): config["estimate"]["matching"]["delta_w"],
        ("tip_step", "estimation"): config["estimate"]["matching"]["tip_step_px"],
        ("shortest", "T"): config["generate"]["shortest"],
        ("longest", "T"): config["generate"]["longest"],
        ("filmed", "before and after T"): config["execute"]["before"],
        ("length", "string"): config["string"]["length"],
        ("points", "string"): config["string"]["points"],
        ("tick", "arm"): config["arm"]["tick"],
        ("hand_speed", "arm"): config["arm"]["hand_speed"],
        ("link_length", "arm"): sum(config["arm"]["links"]),
        ("width", "target"): config["target"]["w"],
        ("height", "target"): config["target"]["h"],
    }
    assert {name: table[name] for name in pairs} == pytest.approx(pairs)


def test_every_experiment_is_swept_shown_and_what_its_name_says():
    launcher = yaml.safe_load(PAPER.read_text())["hydra"]["launcher"]
    variants = launcher["variants"]
    assert get_object(f"stringcast.{launcher['finish']}") is finish
    assert list(variants) == EXPERIMENTS
    settings = {
        name: compose_settings(["+experiment=paper", *overrides])
        for name, overrides in variants.items()
    }
    for name, config in settings.items():
        assert config["string"]["integrator"]["_target_"].endswith(".SemiImplicitEuler")
        if name[1:2] == "_":
            letter, x, y = name.split("_")
            assert (config["target"]["x"], config["target"]["y"]) == (
                int(x) / 1000,
                int(y) / 1000,
            )
            assert (
                config["specimen"]
                == compose_settings([f"specimen={letter}"])["specimen"]
            )
    assert (
        settings["D_500_500"]["string"]["points"]
        == printed_values("points")["string D"]
    )
    assert len(settings["wall"]["obstacles"]["boxes"]) == 1
    assert pd.Series(printed_values("hit_at")).index.isin(EXPERIMENTS).all()


def test_a_job_runs_for_every_experiment_or_for_the_one_that_is_named():
    variants = {"calm": ["target.x=1"], "wild": ["target.x=2"]}
    launcher = LedgerLauncher("", "", False, 0, variants)
    calm, wild = (
        ["seed=0", f"name={name}", *given] for name, given in variants.items()
    )
    assert launcher.expand_variants(["seed=0"]) == [calm, wild]
    assert launcher.expand_variants(["name=wild", "seed=0"]) == [wild]
    with pytest.raises(UserError, match="There are calm, wild"):
        launcher.expand_variants(["name=other"])
