"""The engine of studies: what one job that fails costs, and what a study that goes on
makes.
"""

from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass

import pandas as pd
import pytest

from stringcast.data.schema import Column, Table
from stringcast.pipeline.studies import engine
from stringcast.pipeline.studies.engine import Study, StudyJob
from tests.faults.toy import toy_experiment

DOUBLED = Table(
    "doubled",
    "a row a job",
    (Column("x", "1", "what was doubled", "int"), Column("y", "1", "", "int")),
)
MADE = []


@dataclass(frozen=True)
class Twice(StudyJob):
    x: int

    @property
    def name(self):
        return f"{self.x:02d}"

    def __call__(self):
        MADE.append(self.x)
        if self.x < 0:
            raise ValueError("it is negative")
        return 2 * self.x


class Doubling(Study):
    KIND = "doubling"
    TABLES = {"doubled": DOUBLED}  # noqa: RUF012
    BLOCK, MORE = "doubling", ("numbers",)

    def jobs(self, experiment, folder):
        return [Twice(x) for x in experiment.config["doubling"]["numbers"]]

    def tables(self, experiment, made):
        return {"doubled": pd.DataFrame([{"x": job.x, "y": y} for job, y in made])}

    def draw(self, tables, folder):
        (folder / "drawn").touch()

    def sentence(self, tables):
        return f"{len(tables['doubled'])} doubled."


@contextmanager
def here(processes, lives):
    """Workers that are this very process."""

    class Pool:
        def submit(self, function, *given):
            future = Future()
            try:
                future.set_result(function(*given))
            except Exception as error:
                future.set_exception(error)
            return future

    yield Pool()


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "workers", here)
    MADE.clear()
    return lambda *numbers: Doubling().run(
        toy_experiment(doubling={"numbers": numbers, "processes": 1}),
        tmp_path,
        lambda share: None,
    )


def test_a_job_that_fails_is_told_and_asked_again_and_costs_the_others_nothing(
    run, tmp_path
):
    assert run(3, -1, 1) == "2 doubled. Not made: -1: ValueError: it is negative."
    assert pd.read_parquet(tmp_path / "doubled.parquet").to_dict("list") == {
        "x": [3, 1],
        "y": [6, 2],
    }
    assert (tmp_path / "drawn").exists()
    assert run(3, -1, 1, 2) == "3 doubled. Not made: -1: ValueError: it is negative."
    assert MADE == [3, -1, 1, -1, 2]


def test_where_every_job_fails_the_study_does(run, tmp_path):
    with pytest.raises(ValueError, match="it is negative"):
        run(-1, -2)
    assert not (tmp_path / "doubled.parquet").exists()
