"""The engine of studies: a job that fails, and a study that continues."""

from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass

import pandas as pd
import pytest

from stringcast.data.schema import Column, Table
from stringcast.pipeline.settings.composition import UserError
from tests.benchmarks import study
from tests.benchmarks.study import Study, StudyJob, run_study

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
    TABLES = {"doubled": DOUBLED}  # noqa: RUF012
    BLOCK, GROWING = "doubling", ("numbers",)

    def jobs(self, config, folder):
        return [Twice(x) for x in config["doubling"]["numbers"]]

    def tables(self, config, results):
        return {"doubled": pd.DataFrame([{"x": job.x, "y": y} for job, y in results])}

    def draw(self, tables, folder):
        (folder / "drawn").touch()

    def summary(self, tables):
        return f"{len(tables['doubled'])} doubled."


@contextmanager
def here(processes, calls):
    """Provide workers that are the calling process."""

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
    monkeypatch.setattr(study, "worker_pool", here)
    MADE.clear()

    def run(*numbers, seed=0):
        config = {"seed": seed, "doubling": {"numbers": list(numbers), "processes": 1}}
        return run_study(Doubling(), config, tmp_path, lambda share: None)

    return run


def test_a_job_that_fails_is_told_and_asked_again_and_costs_the_others_nothing(
    run, tmp_path
):
    assert run(3, -1, 1) == "2 doubled. Failed: -1: ValueError: it is negative."
    assert pd.read_parquet(tmp_path / "doubled.parquet").to_dict("list") == {
        "x": [3, 1],
        "y": [6, 2],
    }
    assert (tmp_path / "drawn").exists()
    assert run(3, -1, 1, 2) == "3 doubled. Failed: -1: ValueError: it is negative."
    assert MADE == [3, -1, 1, -1, 2]


def test_where_every_job_fails_the_study_does(run, tmp_path):
    with pytest.raises(ValueError, match="it is negative"):
        run(-1, -2)
    assert not (tmp_path / "doubled.parquet").exists()


def test_a_folder_holds_one_study_that_may_grow(run, tmp_path):
    run(1)
    run(1, 2)
    with pytest.raises(UserError, match=r"other settings \(seed\)"):
        run(1, seed=1)
