"""The cost of all steps is estimated; above a limit the user is asked."""

import io
import json
import sys

import pytest

from stringcast.pipeline.cli.terminal import Terminal
from stringcast.pipeline.commands import load_command
from stringcast.pipeline.run.cost import ask_about_cost, estimate_costs
from stringcast.pipeline.settings.composition import UserError
from tests.experiments import compose_experiment, resolve_settings

LIMIT_HOURS = 4.0
SAMPLE = "trials=data/sample"


def ask(*overrides, console=None):
    ask_about_cost(
        compose_experiment(*overrides), LIMIT_HOURS, console or Terminal(quiet=True)
    )


@pytest.mark.parametrize(
    "overrides",
    [
        ("+experiment=stringB",),
        ("+experiment=gap",),
        ("+experiment=align",),
        ("+experiment=diagnose", SAMPLE),
        ("+experiment=estimate", SAMPLE, "estimate=least_squares", "trials_used=all"),
        ("+experiment=calibrate",),
    ],
)
def test_cheap_runs_need_no_question(overrides):
    ask(*overrides)
    costs = estimate_costs(compose_experiment(*overrides))
    assert all(cost.core_hours < 0.1 for cost in costs)


@pytest.mark.parametrize(
    ("overrides", "stage", "settings"),
    [
        (("camera.fps=1e5", "camera.width=20000"), "execute", "camera.fps = 100000.0"),
        (
            ("string.largest_step=1e-6", "string.points=10000"),
            "estimate",
            "string.largest_step = 1e-06",
        ),
        (("method=paper", "generate.attempts=10000000", "generate.longest=60",
          "max_casts=1"), "generate", "generate.attempts = 10000000"),
        (("look=excite", "excite=look", "excite.duration=60", "camera.fps=1e5"),
         "execute", "excite.duration = 60"),
        (("estimate=cma_es", "estimate.candidates=10000000"), "estimate",
         "estimate.candidates = 10000000"),
        (("+experiment=diagnose", SAMPLE, "diagnose.starts=10000"), "diagnose",
         "diagnose.starts = 10000, trials = 3.73 s in 5 trials"),
    ],
)  # fmt: skip
def test_expensive_runs_are_refused_with_setting_and_consent_option(
    overrides, stage, settings
):
    with pytest.raises(UserError, match=rf"^stage {stage} would take") as raised:
        ask(*overrides)
    message = str(raised.value)
    assert settings in message
    allowed = float(message.rpartition("max_core_hours=")[2])
    ask_about_cost(compose_experiment(*overrides), allowed, Terminal(quiet=True))


@pytest.mark.parametrize(("answer", "begins"), [("y", True), ("", False)])
def test_user_at_the_terminal_is_asked(monkeypatch, answer, begins):
    console = Terminal(file=io.StringIO(), force_terminal=True, width=1000)
    keyboard = io.StringIO(f"{answer}\n")
    keyboard.isatty = lambda: True
    monkeypatch.setattr(sys, "stdin", keyboard)
    costly = ("estimate=cma_es", "estimate.candidates=10000000")
    if begins:
        ask(*costly, console=console)
    else:
        with pytest.raises(UserError, match="Nothing was begun"):
            ask(*costly, console=console)
    assert "Begin all the same?" in console.file.getvalue()


@pytest.mark.parametrize("command", ["resume", "verify"])
def test_cost_limit_is_not_inherited_from_a_run(tmp_path, command):
    costly = ("estimate=cma_es", "estimate.candidates=10000000")
    config = resolve_settings(*costly, "max_core_hours=1000000")
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(UserError, match=r"= 4\. .* --max-core-hours \d"):
        load_command(command)([str(tmp_path)])
    assert {file.name for file in tmp_path.iterdir()} == {"config.json"}
