"""Checks of measured data: contents, faults and remedies."""
