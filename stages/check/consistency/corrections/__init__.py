"""Corrections: each undoes one common mistake in measurements."""
