"""The forward model: hand, string, camera. Everything that generates, estimates or
diagnoses asks it.
"""
