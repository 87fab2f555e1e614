"""The search for causes, one at a time."""
