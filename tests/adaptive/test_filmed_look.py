"""A look is filmed and read; its estimate finds the hidden value of a hand effect."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.composition import compose_settings
from stringcast.stages.estimate.least_squares import estimate
from stringcast.stages.estimate.matching import Matching
from stringcast.stages.model.library import find_effects


class TrialsReadError(Exception):
    """The look was read, and its trials are known."""


class LookExecutor:
    """Runs the steps of a look until its causes would be searched for."""

    def __init__(self, experiment):
        self.experiment = experiment

    def obtain(self, step):
        if step.stage.name == "explain":
            raise TrialsReadError(step.inputs["trials"], step.inputs["estimate"])
        return self.experiment.run_step(step, lambda share: None)


@pytest.mark.long
@pytest.mark.parametrize(("specimen", "seed"), [("B", 995), ("C", 996)])
def test_joint_gain_is_found_in_a_look_whose_hand_moves_by_less_than_a_pixel(
    specimen, seed
):
    """Read lines were taken to start at the real hand: the gain was 0.028 to 0.030."""
    settings = compose_settings(
        [
            "method=adaptive",
            f"specimen={specimen}",
            f"seed={seed}",
            "+specimen.hidden.joint_gain.gain=0.04",
        ]
    )
    config = OmegaConf.to_container(OmegaConf.create(settings), resolve=True)
    experiment = prepare_experiment(config, lambda block: f"conf/{block}")
    executor = LookExecutor(experiment)
    with pytest.raises(TrialsReadError) as read:
        experiment.mode.run_steps(experiment, Path(), executor)
    trials, before = read.value.args
    (look,) = trials.observations
    assert "hand_shift" not in look.readings  # the reported hand was used

    search = config["explain"]
    found = estimate(
        experiment.model.with_effects(*find_effects(["joint_gain"])),
        trials.observations,
        before,
        seed=1,
        cast_number=1,
        starts=search["starts"],
        screening=search["screening"],
        iterations=search["iterations"],
        matching=Matching(**search["matching"]),
    )
    gain = found.parameters.set_index("name").loc["joint_gain.gain"]
    assert gain["low"] <= 0.04 <= gain["high"]
    assert gain["value"] == pytest.approx(0.04, abs=0.0015)
