"""Calls in worker processes: results, log and errors are those of one process."""

import logging
import os
import signal
import threading
import time

import numpy as np
import pandas as pd
import pytest
from conftest import TRUTH, ordinary
from synthetic_trials import CRITERIA

from stringcast.data.diagnoses import Diagnosis
from stringcast.stages.common import InterruptRequest
from stringcast.stages.diagnose.evidence import left_out_fits
from stringcast.stages.diagnose.search.candidate_comparison import compare_candidates
from stringcast.stages.diagnose.trials.discretisation import with_second_order_mesh
from stringcast.stages.inference.prepared_trial import with_model
from stringcast.stages.kept_results import content_digest
from stringcast.stages.model.effects.arm_lag import ArmLag
from stringcast.stages.model.effects.camera_offset import CameraOffset
from stringcast.stages.model.effects.wind import Wind
from stringcast.stages.workers import CAN_FORK, map_in_workers, use_workers
from tests.diagnosis.test_forward_selection import diagnose_casts
from tests.diagnosis.test_identifiability import prepare_swings, simulate_swings

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="needs a safe fork")
log = logging.getLogger("stringcast.tests.workers")
DEADLINE_S = 10.0  # time for workers to end


class Lines(logging.Handler):
    """A handler that collects messages."""

    def __init__(self):
        super().__init__()
        self.messages = []

    def emit(self, record):
        self.messages.append(record.getMessage())


@pytest.fixture
def lines():
    handler = Lines()
    log.addHandler(handler)
    level = log.level
    log.setLevel(logging.INFO)
    yield handler.messages
    log.setLevel(level)
    log.removeHandler(handler)


def is_running(process):
    """Return whether a process that is not a child of this one is running."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until_ended(processes):
    deadline = time.monotonic() + DEADLINE_S
    while any(map(is_running, processes)):
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_and_log_are_in_the_order_of_the_calls(lines, workers):
    def call(number):
        time.sleep(0.02 * (number % 3 == 0))
        log.info("first of %d", number)
        log.info("second of %d", number)
        return number**2, os.getpid()

    with use_workers(workers):
        answers = map_in_workers(call, range(8))
    assert [square for square, _ in answers] == [k**2 for k in range(8)]
    expected = [f"{word} of {k}" for k in range(8) for word in ("first", "second")]
    assert lines == expected
    processes = {process for _, process in answers}
    assert len(processes) <= workers
    assert (os.getpid() in processes) == (workers == 1)


def test_a_worker_has_no_workers():
    def inner_processes(number):
        return {os.getpid(), *map_in_workers(lambda k: os.getpid(), range(3))}

    with use_workers(2):
        for processes in map_in_workers(inner_processes, range(2)):
            assert len(processes) == 1


def test_an_error_is_raised_after_the_calls_before_it(lines):
    def fail_at_three(number):
        log.info("%d", number)
        if number == 3:
            raise ValueError("number three")

    with use_workers(2), pytest.raises(ValueError, match="number three"):
        map_in_workers(fail_at_three, range(6))
    assert lines == ["0", "1", "2", "3"]


def test_calls_of_killed_workers_are_repeated():
    parent = os.getpid()

    def end_in_worker(number):
        if number in (1, 4) and os.getpid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    with use_workers(2):
        assert map_in_workers(end_in_worker, range(7)) == [*range(7)]


def test_an_interruption_ends_all_workers(tmp_path):
    def write_process_and_wait(number):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(60)

    def interrupt(number, frame):
        raise InterruptRequest

    def interrupt_when_both_work():
        while len(os.listdir(tmp_path)) < 2:
            time.sleep(0.01)
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGINT, interrupt)
    threading.Thread(target=interrupt_when_both_work).start()
    try:
        with use_workers(2), pytest.raises(InterruptRequest):
            map_in_workers(write_process_and_wait, range(4))
    finally:
        signal.signal(signal.SIGINT, before)
    assert not any(is_running(int(name)) for name in os.listdir(tmp_path))


def test_an_interruption_while_a_worker_starts_is_not_lost():
    """Python ignores exceptions in callbacks of a fork, such as signal handlers."""

    def interrupt(number, frame):
        raise InterruptRequest

    def interrupt_once():
        if not interrupted:
            interrupted.append(True)
            thread = threading.Thread(target=signal.raise_signal, args=[signal.SIGTERM])
            thread.start()
            thread.join()

    interrupted = []
    os.register_at_fork(after_in_parent=interrupt_once)
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        with use_workers(2), pytest.raises(InterruptRequest):
            map_in_workers(abs, range(4))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert signal.getsignal(signal.SIGTERM) is before


def test_workers_end_if_their_process_is_killed(tmp_path):
    def write_process_and_wait(number):
        (tmp_path / str(os.getpid())).touch()
        time.sleep(60)

    process = os.fork()
    if process == 0:
        with use_workers(2):
            map_in_workers(write_process_and_wait, range(4))
        os._exit(0)
    while len(os.listdir(tmp_path)) < 2:
        time.sleep(0.01)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    wait_until_ended([int(name) for name in os.listdir(tmp_path)])


@pytest.fixture(scope="module")
def prepared(arm):
    """Prepare three swings of a string in wind, and fit the base model."""
    model = with_second_order_mesh(ordinary(arm))
    windy = model.with_effects(Wind)
    trials = simulate_swings(arm, windy, TRUTH | {"wind.along_x": 1.0}, 0)
    return prepare_swings(with_model(trials, model), model)


def test_two_workers_select_causes_with_identical_results(prepared):
    steps = []
    for workers in (1, 2):
        with use_workers(workers):
            step = compare_candidates(
                prepared, prepared.base_fit, (ArmLag, CameraOffset, Wind), CRITERIA, 0
            )
        steps.append(step)
    one, other = (
        [[proposal.starts for proposal in step.proposals], step.fits, step.compared]
        for step in steps
    )
    assert steps[0].best.hypothesis.cause_names == ("wind",)
    assert content_digest(one) == content_digest(other)


def test_two_workers_refit_without_trials_with_identical_results(prepared, monkeypatch):
    monkeypatch.setattr(left_out_fits, "MIN_GAIN", -1.0)  # no step is enough
    refits = []
    for workers in (1, 2):
        with use_workers(workers):
            groups = [[0], [1], [2]]
            fitted = left_out_fits.exponents_without_groups(
                prepared.data, prepared.base_fit, groups
            )
        refits.append(fitted)
    np.testing.assert_array_equal(*refits)
    assert len(np.unique(refits[0], axis=0)) == 3


@pytest.mark.long
def test_a_diagnosis_is_identical_with_two_workers(arm, camera, monkeypatch):
    diagnoses = []
    for workers in (1, 2):
        with use_workers(workers):
            truth = {"tip_mass.ratio": 0.05}
            diagnoses.append(diagnose_casts(arm, camera, truth, monkeypatch))
    for name in Diagnosis.TABLES:
        one, other = (getattr(diagnosis, name) for diagnosis in diagnoses)
        pd.testing.assert_frame_equal(one, other, check_exact=True)
