"""Ctrl-C while a stage works: what it knows then is kept and shown, and made again by who goes on."""

import os
import signal
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from stringcast.data.artifacts import Diagnosis
from stringcast.hardware.virtual.blind import VERSIONS, draw
from stringcast.pipeline.experiment import prepare
from stringcast.pipeline.layout import ENDED
from stringcast.pipeline.stopping import stoppable
from stringcast.pipeline.terminal import Terminal
from stringcast.stages.common import Enough
from tests.pipeline.test_decide import COARSE, proposing


@pytest.fixture(scope="module")
def data(arm, camera, tmp_path_factory):
    folder = tmp_path_factory.mktemp("theirs")
    draw(VERSIONS[1].cases.index("none"), arm, camera, 1).write(folder)
    return folder


def performed(data, folder, diagnose):
    with initialize_config_dir(str(Path("conf").resolve()), version_base="1.3"):
        overrides = ["+experiment=diagnose", f"trials={data}", "string.length=0.33", "keep=[]", *COARSE]
        config = OmegaConf.to_container(compose("config", overrides), resolve=True)
    here = prepare(config, lambda block: f"conf/{block}")
    here = replace(here, stages={**here.stages, "diagnose": diagnose})
    console = Terminal(record=True, file=open(os.devnull, "w"), width=200)  # noqa: SIM115
    try:
        here.mode.perform(here, folder, console)
    except KeyboardInterrupt:
        return "interrupted " + console.export_text()
    return console.export_text()


def asked(*given, **more) -> Diagnosis:
    """Proposes nothing, whatever it is given."""
    made = proposing(*given, **more)
    tables = {name: table.empty() for name, table in Diagnosis.TABLES.items()}
    return Diagnosis(
        **tables | {"finding": made.finding.assign(diagnosis='{"trials": {"rejected": {}}, "next_experiment": null}')}
    )


def patient(*given, **more) -> Diagnosis:
    """Ends with what it knows."""
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except Enough:
        return asked(*given, **more)
    raise AssertionError("nobody interrupted it")


def hasty(*given, **more) -> Diagnosis:
    """Lets it pass."""
    os.kill(os.getpid(), signal.SIGINT)
    raise AssertionError("nobody interrupted it")


def test_what_a_step_knew_is_kept_and_made_again(data, tmp_path):
    assert performed(data, tmp_path, patient).startswith("interrupted")
    assert (tmp_path / "diagnosis.json").exists()
    assert not (tmp_path / ENDED).exists()
    said = performed(data, tmp_path, asked)
    assert "recomputing" in said
    assert "it was interrupted" in said
    assert (tmp_path / ENDED).exists()
    assert "recomputing" not in performed(data, tmp_path, asked)


def test_a_stage_that_knows_nothing_leaves_nothing(data, tmp_path):
    assert performed(data, tmp_path, hasty).startswith("interrupted")
    assert not (tmp_path / "diagnosis.json").exists()
    assert not list((tmp_path / "iterations").rglob("diagnosis"))


def test_only_the_first_asks_for_an_end_and_only_meanwhile():
    before = signal.getsignal(signal.SIGINT)
    with stoppable() as stopped:
        assert not stopped()
        with pytest.raises(Enough):
            os.kill(os.getpid(), signal.SIGINT)
        assert stopped()
        with pytest.raises(KeyboardInterrupt) as raised:
            os.kill(os.getpid(), signal.SIGINT)
        assert raised.type is KeyboardInterrupt
    assert signal.getsignal(signal.SIGINT) is before


def test_in_another_thread_it_does_nothing():
    seen = []

    def work():
        with stoppable() as stopped:
            seen.append(stopped())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]
