"""The table of all blind studies: no row twice, none without a code, no states of the code counted together."""

import re

import pandas as pd
import pytest

from stringcast.data.store import read_table
from stringcast.pipeline.studies.blind.record import FOLDER, appended, by_code, completed, in_markdown
from stringcast.pipeline.studies.blind.scores import BENCHES, OWN


def test_every_recorded_bench_names_its_code():
    benches = read_table(BENCHES, FOLDER / "benches.parquet")
    assert benches["code"].str.fullmatch("[0-9a-f]{7,40}").all()
    pd.testing.assert_frame_equal(appended([benches, benches.tail(5)]), completed(benches))


def test_a_study_is_added_and_counted_by_itself():
    benches = read_table(BENCHES, FOLDER / "benches.parquet")
    later = benches[completed(benches)["laboratory"] == OWN].tail(3).assign(code="f" * 40, correct=False)
    rates = by_code(appended([benches, later]))
    before = by_code(benches)
    pd.testing.assert_frame_equal(rates[rates["code"] != "f" * 40].reset_index(drop=True), before)
    assert rates[rates["code"] == "f" * 40]["benches"].eq(3).all()
    assert in_markdown(rates).splitlines()[-1].startswith("| fffffff | own | 3 |")


RATES = ("cause found", "false alarm", "outside called unknown", "parameter in its interval")


@pytest.mark.parametrize(
    "page", ["README.md", "data/results/blind_study/README.md", "data/results/blind_study/by_rules.md"]
)
def test_pages_say_what_the_table_says(page):
    """Each line that begins with codes and nothing else: its figures are those of all of these codes together."""
    rates = by_code(read_table(BENCHES, FOLDER / "benches.parquet"))
    lines = (FOLDER.parents[2] / page).read_text(encoding="utf-8").splitlines()
    told = 0
    for line in lines:
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) < 3 or not re.fullmatch("[0-9a-f]{7}(, [0-9a-f]{7})*", cells[1]):
            continue
        some = rates[rates["code"].str[:7].isin(cells[1].split(", "))]
        totals = some.groupby("name")[["right", "count"]].sum()
        for right, count in totals.loc[[*RATES]].itertuples(index=False):
            assert not count or f"{right} of {count}" in line, (page, cells[1])
        told += 1
    assert told >= 2
