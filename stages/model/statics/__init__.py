"""Statics."""
