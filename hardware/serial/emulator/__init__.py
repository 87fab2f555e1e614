"""A device on a pseudo-terminal: reference firmware, arm dynamics, and faults on
request.
"""
