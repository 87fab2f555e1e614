"""Estimate of the offset between the clocks of arm and camera."""
