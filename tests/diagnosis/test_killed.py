"""A killed diagnosis resumes with the call in progress."""

import numpy as np
import pandas as pd
import pytest

from stringcast.data.diagnoses import Diagnosis
from stringcast.stages.inference import solver
from stringcast.stages.kept_results import use_store
from tests.diagnosis.test_forward_selection import diagnose_casts

TRUTH = {"tip_mass.ratio": 0.05}


class Killed(BaseException):
    """An exception that simulates a kill: no code catches it."""


class Memory:
    """A store that survives a process killed after a number of results."""

    def __init__(self, kept=(), lives=10**9):
        self.kept, self.lives, self.found = dict(kept), lives, 0

    def find(self, key):
        self.found += key in self.kept
        return self.kept.get(key)

    def keep(self, key, result):
        if self.lives == 0:
            raise Killed
        self.lives -= 1
        self.kept[key] = tuple(np.array(array) for array in result)


def diagnose_with(store, arm, camera, monkeypatch):
    with use_store(store):
        return diagnose_casts(arm, camera, TRUTH, monkeypatch)


def assert_same(first, second):
    for name in Diagnosis.TABLES:
        tables = getattr(first, name), getattr(second, name)
        pd.testing.assert_frame_equal(*tables, check_exact=True)


@pytest.mark.long
def test_a_killed_diagnosis_resumes_to_identical_results(arm, camera, monkeypatch):
    whole = diagnose_casts(arm, camera, TRUTH, monkeypatch)
    kept, lives = {}, 0
    while True:
        store = Memory(kept, lives=7)
        try:
            resumed = diagnose_with(store, arm, camera, monkeypatch)
            break
        except Killed:
            lives += 1
            kept = store.kept
    assert lives > 2
    assert_same(whole, resumed)

    # All results are stored: nothing is fitted again
    fits = []
    fit = solver.fit_least_squares
    monkeypatch.setattr(
        "stringcast.stages.inference.laplace.solver.fit_least_squares",
        lambda *given, **named: fits.append(1) or fit(*given, **named),
    )
    store = Memory(store.kept, lives=0)
    assert_same(whole, diagnose_with(store, arm, camera, monkeypatch))
    assert fits == []
    assert store.found >= len(store.kept)
