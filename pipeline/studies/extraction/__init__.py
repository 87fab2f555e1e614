"""The extraction study: casts rendered under every condition, read, and compared with
what was really so.
"""
