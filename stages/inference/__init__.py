"""Inference: the likelihood of trials, the best parameters, and their uncertainty."""
