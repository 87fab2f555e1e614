"""The trials of a diagnosis, corrected at the base model."""
