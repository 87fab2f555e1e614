"""Whether measured data can be trusted: what is there, what looks wrong and what to do,
before anything runs.
"""
