"""The table of all blind studies: no row twice, none without a code, no states of the code counted together."""

import pandas as pd

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


def test_pages_say_what_the_table_says():
    """Of the last two codes: the numbers that README.md and the study's page put first."""
    rates = by_code(read_table(BENCHES, FOLDER / "benches.parquet")).set_index(["code", "name"])
    root = FOLDER.parents[2]
    for page in (root / "README.md", FOLDER / "by_rules.md"):
        lines = page.read_text(encoding="utf-8").splitlines()
        for code in ("f743bdb", "08313c3"):
            line = next(one for one in lines if one.startswith("|") and f"{code} |" in one)
            some = rates[[c.startswith(code) for c, _ in rates.index]].droplevel(0)
            for name in (
                "cause found",
                "pair found",
                "false alarm",
                "outside called unknown",
                "parameter in its interval",
            ):
                if some.loc[name, "count"]:
                    assert f"{some.loc[name, 'right']} of {some.loc[name, 'count']}" in line, (page, name)
