"""Offsets between the clocks of trials."""
