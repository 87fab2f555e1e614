"""The command of studies: every study composes, and every name leads to code."""

from importlib import import_module

import pytest

from tests.benchmarks.__main__ import COMMANDS, STUDIES, main
from tests.benchmarks.study import study_settings


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_settings_and_a_class(name):
    module, _, kind = STUDIES[name].rpartition(".")
    study = getattr(import_module(f"tests.benchmarks.{module}"), kind)()
    config = study_settings(name)
    assert config["name"] == name
    assert set(study.GROWING) <= set(config[study.BLOCK])


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        import_module(f"tests.benchmarks.{COMMANDS[name]}").main(["--help"])
    assert stopped.value.code == 0
    assert "study" in capsys.readouterr().out


def test_an_unknown_name_and_a_wrong_setting_are_refused(capsys, tmp_path):
    assert main(["nothing"]) == 2
    assert main(["casting", f"folder={tmp_path}", "casting.seeds=0"]) == 1
    assert "casting.seeds = 0" in capsys.readouterr().err
