"""Ctrl-C while a stage works.

Its results so far are kept and shown, and made again when the run continues.
"""

import ctypes
import json
import os
import signal
import sys
import threading
import time
from dataclasses import replace

import pandas as pd
import pytest

from stringcast.data.diagnoses import Diagnosis
from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.run.file_names import SUMMARY_FILE
from stringcast.pipeline.run.stopping import (
    repeat_ignored_interrupts,
    stop_stage_on_interrupt,
)
from stringcast.stages.common import InterruptRequest
from tests.pipeline.small import about


@pytest.fixture(autouse=True)
def heard():
    """Handle SIGINT as in a terminal.

    A process that a shell starts in the background ignores it.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def clocks_are_together(monkeypatch):
    """Spare each run the estimate of the clocks, which takes 5 s; others test it."""
    place = "stringcast.pipeline.modes.diagnose.refuse_unlike_clocks"
    monkeypatch.setattr(place, lambda *given: None)


def performed(trials, folder, diagnose):
    here = about(trials, "+experiment=diagnose", "saved_outputs=[]")
    here = replace(here, stages={**here.stages, "diagnose": diagnose})
    console = Terminal(record=True, file=open(os.devnull, "w"), width=200)  # noqa: SIM115
    try:
        here.mode.perform(here, folder, console)
    except KeyboardInterrupt:
        return "interrupted " + console.export_text()
    return console.export_text()


def said(**more):
    text = {
        "trials": {"rejected": {}},
        "causes": [],
        "next_experiment": None,
        **more,
    }
    row = {
        "verdict": "insufficient",
        "sentence": "So.",
        "diagnosis": json.dumps(text),
        "extended": "effects: []",
    }
    return Diagnosis(
        **{n: table.empty() for n, table in Diagnosis.TABLES.items()}
        | {"finding": pd.DataFrame([row])}
    )


def whole(*given, **more) -> Diagnosis:
    """Return a finished diagnosis."""
    return said(interrupted=False)


def patient(*given, **more) -> Diagnosis:
    """Return an unfinished diagnosis when interrupted."""
    try:
        signal.raise_signal(signal.SIGINT)
    except InterruptRequest:
        return said(interrupted=True)
    raise AssertionError("nobody interrupted it")


def hasty(*given, **more) -> Diagnosis:
    """Let the interruption pass."""
    signal.raise_signal(signal.SIGINT)
    raise AssertionError("nobody interrupted it")


def test_what_a_step_knew_is_kept_and_made_again(sample_trial, tmp_path):
    assert performed(sample_trial, tmp_path, patient).startswith("interrupted")
    assert (tmp_path / "diagnosis.json").exists()
    assert not (tmp_path / SUMMARY_FILE).exists()
    shown = performed(sample_trial, tmp_path, whole)
    assert "recomputing" in shown
    assert "it was interrupted" in shown
    assert (tmp_path / SUMMARY_FILE).exists()
    assert "recomputing" not in performed(sample_trial, tmp_path, whole)


def test_a_stage_that_knows_nothing_leaves_nothing(sample_trial, tmp_path):
    assert performed(sample_trial, tmp_path, hasty).startswith("interrupted")
    assert not (tmp_path / "diagnosis.json").exists()
    assert not list((tmp_path / "iterations").rglob("diagnosis"))


def test_only_the_first_asks_for_an_end_and_only_meanwhile():
    before = signal.getsignal(signal.SIGINT)
    with stop_stage_on_interrupt():
        with pytest.raises(InterruptRequest):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt) as raised:
            signal.raise_signal(signal.SIGINT)
        assert raised.type is KeyboardInterrupt
    assert signal.getsignal(signal.SIGINT) is before


@ctypes.CFUNCTYPE(None)
def press_in_a_callback_from_c():
    """Press Ctrl-C where LLVM calls back: Python ignores what is raised here."""
    signal.raise_signal(signal.SIGINT)


def press_and_work():
    press_in_a_callback_from_c()
    for _ in range(100):  # Python hears of a signal between two sleeps
        time.sleep(0.05)


@pytest.fixture
def ignored(monkeypatch):
    """Collect what Python ignores, and send ignored interrupts again."""
    others = []
    monkeypatch.setattr(sys, "unraisablehook", others.append)
    repeat_ignored_interrupts()
    return others


def test_an_interrupt_that_python_ignored_is_sent_again(ignored):
    with pytest.raises(KeyboardInterrupt):
        press_and_work()
    assert not ignored


def test_a_stage_hears_of_an_interrupt_that_python_ignored(ignored):
    with stop_stage_on_interrupt():
        with pytest.raises(InterruptRequest):
            press_and_work()
        with pytest.raises(KeyboardInterrupt) as raised:
            press_and_work()
        assert raised.type is KeyboardInterrupt


def test_other_errors_that_python_ignores_are_left_to_it(ignored):
    def fail():
        raise ValueError

    ctypes.CFUNCTYPE(None)(fail)()
    time.sleep(0.1)
    assert [one.exc_type for one in ignored] == [ValueError]


def test_where_signals_are_ignored_they_stay_so():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with stop_stage_on_interrupt():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_in_another_thread_it_does_nothing():
    seen = []

    def work():
        with stop_stage_on_interrupt():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]
