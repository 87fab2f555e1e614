"""Ctrl-C during a stage.

Preliminary results are stored and shown, and recomputed when the run continues.
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
def handle_interrupts():
    """Handle SIGINT as in a terminal; background processes ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def clocks_are_together(monkeypatch):
    """Skip the test of clocks, which takes 5 s."""
    place = "stringcast.pipeline.modes.diagnose.refuse_unlike_clocks"
    monkeypatch.setattr(place, lambda *given: None)


def run_diagnosis(trials, folder, diagnose):
    here = about(trials, "+experiment=diagnose", "saved_outputs=[]")
    here = replace(here, stages={**here.stages, "diagnose": diagnose})
    console = Terminal(record=True, file=open(os.devnull, "w"), width=200)  # noqa: SIM115
    try:
        here.mode.perform(here, folder, console)
    except KeyboardInterrupt:
        return "interrupted " + console.export_text()
    return console.export_text()


def diagnosis(**more):
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


def finished_diagnosis(*given, **more) -> Diagnosis:
    """Return a finished diagnosis."""
    return diagnosis(interrupted=False)


def handle_interrupt_in_diagnosis(*given, **more) -> Diagnosis:
    """Return an unfinished diagnosis when interrupted."""
    try:
        signal.raise_signal(signal.SIGINT)
    except InterruptRequest:
        return diagnosis(interrupted=True)
    raise AssertionError("nobody interrupted it")


def ignore_interrupt_in_diagnosis(*given, **more) -> Diagnosis:
    """Do not handle an interrupt."""
    signal.raise_signal(signal.SIGINT)
    raise AssertionError("nobody interrupted it")


def test_preliminary_result_is_stored_and_recomputed(sample_trial, tmp_path):
    assert run_diagnosis(
        sample_trial, tmp_path, handle_interrupt_in_diagnosis
    ).startswith("interrupted")
    assert (tmp_path / "diagnosis.json").exists()
    assert not (tmp_path / SUMMARY_FILE).exists()
    shown = run_diagnosis(sample_trial, tmp_path, finished_diagnosis)
    assert "recomputing" in shown
    assert "it was interrupted" in shown
    assert (tmp_path / SUMMARY_FILE).exists()
    assert "recomputing" not in run_diagnosis(
        sample_trial, tmp_path, finished_diagnosis
    )


def test_interrupted_stage_without_a_result_stores_nothing(sample_trial, tmp_path):
    assert run_diagnosis(
        sample_trial, tmp_path, ignore_interrupt_in_diagnosis
    ).startswith("interrupted")
    assert not (tmp_path / "diagnosis.json").exists()
    assert not list((tmp_path / "iterations").rglob("diagnosis"))


def test_second_interrupt_raises_keyboard_interrupt():
    before = signal.getsignal(signal.SIGINT)
    with stop_stage_on_interrupt():
        with pytest.raises(InterruptRequest):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt) as raised:
            signal.raise_signal(signal.SIGINT)
        assert raised.type is KeyboardInterrupt
    assert signal.getsignal(signal.SIGINT) is before


@ctypes.CFUNCTYPE(None)
def interrupt_in_callback():
    """Press Ctrl-C in a callback like LLVM's, where Python ignores exceptions."""
    signal.raise_signal(signal.SIGINT)


def interrupt_and_sleep():
    interrupt_in_callback()
    for _ in range(100):  # Python handles signals between two sleeps
        time.sleep(0.05)


@pytest.fixture
def unraisable(monkeypatch):
    """Collect ignored exceptions, and repeat ignored interrupts."""
    others = []
    monkeypatch.setattr(sys, "unraisablehook", others.append)
    repeat_ignored_interrupts()
    return others


def test_ignored_interrupt_is_repeated(unraisable):
    with pytest.raises(KeyboardInterrupt):
        interrupt_and_sleep()
    assert not unraisable


def test_ignored_interrupt_stops_the_stage(unraisable):
    with stop_stage_on_interrupt():
        with pytest.raises(InterruptRequest):
            interrupt_and_sleep()
        with pytest.raises(KeyboardInterrupt) as raised:
            interrupt_and_sleep()
        assert raised.type is KeyboardInterrupt


def test_other_ignored_errors_reach_the_default_hook(unraisable):
    def fail():
        raise ValueError

    ctypes.CFUNCTYPE(None)(fail)()
    time.sleep(0.1)
    assert [one.exc_type for one in unraisable] == [ValueError]


def test_ignored_signals_stay_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with stop_stage_on_interrupt():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_do_not_handle_signals():
    seen = []

    def work():
        with stop_stage_on_interrupt():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]
