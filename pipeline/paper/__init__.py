"""Repeat the paper's experiments on the virtual lab and compare the numbers."""
