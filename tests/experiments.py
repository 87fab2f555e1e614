"""Settings as a command line composes them, and experiments with them."""

from omegaconf import OmegaConf

from stringcast.pipeline.run.experiment import prepare_experiment
from stringcast.pipeline.settings.composition import compose_settings


def resolve_settings(*overrides):
    """Return all settings with these overrides, and values in place of references."""
    config = OmegaConf.create(compose_settings(overrides))
    return OmegaConf.to_container(config, resolve=True)


def compose_experiment(*overrides):
    """Return the experiment with these overrides, ready to be performed."""
    return prepare_experiment(
        resolve_settings(*overrides), lambda block: f"conf/{block}"
    )
