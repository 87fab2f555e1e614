"""The stages of a casting experiment: pure functions from artifacts to artifacts."""
