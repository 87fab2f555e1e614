"""The evidence for causes: posteriors, intervals and predictions."""
