"""All options of conf/hardware and conf/execute are valid."""

import pytest
from conftest import ROOT

from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import bind_stage
from tests.experiments import resolve_settings

CONF = ROOT / "conf"


def options(group):
    return [
        pytest.param(group, path.stem, id=f"{group}={path.stem}")
        for path in sorted((CONF / group).glob("*.yaml"))
    ]


@pytest.mark.parametrize(
    ("group", "option"), [*options("hardware"), *options("execute")]
)
def test_hardware_options_compose_with_valid_settings(group, option):
    settings = resolve_settings(f"{group}={option}")[group]
    assert callable(bind_stage(settings, group, "conf"))
    with pytest.raises(UserError, match="no such setting"):
        bind_stage({**settings, "unheard_of": 1}, group, "conf")


def test_workspace_with_exchanged_corners_is_refused_by_name():
    settings = resolve_settings("hardware=serial")["hardware"]
    settings["driving"]["workspace"]["low"] = [1.0, 1.0]
    with pytest.raises(
        UserError, match=r"hardware\.driving\.workspace.*each of workspace\.low"
    ):
        bind_stage(settings, "hardware", "conf/hardware/serial.yaml")
