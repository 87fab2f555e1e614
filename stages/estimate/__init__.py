"""Estimate: the string's parameters from trials, three ways with one signature (IV)."""
