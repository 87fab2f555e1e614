"""Checks of measured data: what is there, what looks wrong and how to correct it."""
