"""Every option of conf/hardware and conf/execute has valid settings."""

from pathlib import Path

import pytest
from conftest import ROOT
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import bind_stage

CONF = ROOT / "conf"


def options(group):
    return [
        pytest.param(group, path.stem, id=f"{group}={path.stem}")
        for path in sorted((CONF / group).glob("*.yaml"))
    ]


def block(group, option):
    with initialize_config_dir(str(Path(CONF)), version_base="1.3"):
        return OmegaConf.to_container(
            compose("config", [f"{group}={option}"]), resolve=True
        )[group]


@pytest.mark.parametrize(
    ("group", "option"), [*options("hardware"), *options("execute")]
)
def test_an_option_composes_and_its_settings_are_checked(group, option):
    settings = block(group, option)
    assert callable(bind_stage(settings, group, "conf"))
    with pytest.raises(UserError, match="no such setting"):
        bind_stage({**settings, "unheard_of": 1}, group, "conf")


def test_a_workspace_inside_out_is_refused_by_name():
    settings = block("hardware", "serial")
    settings["driving"]["workspace"]["low"] = [1.0, 1.0]
    with pytest.raises(
        UserError, match=r"hardware\.driving\.workspace.*each of workspace\.low"
    ):
        bind_stage(settings, "hardware", "conf/hardware/serial.yaml")
