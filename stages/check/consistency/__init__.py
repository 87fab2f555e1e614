"""Consistency of hand, string and clocks: what fits, and what would have to change."""
