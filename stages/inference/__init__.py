"""Inference: how likely trials are under a model, the most likely parameters, and how
sure they are.
"""
