"""The blind study: benches that hide a cause, diagnosed, and only then their envelopes
opened and scores made.
"""
