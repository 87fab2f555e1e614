"""Physical effects on the string, one file each. See `stages.model.effect` for what a
file holds.
"""
