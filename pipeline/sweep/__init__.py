"""Sweeps: many runs, begun by one command, on this machine or a cluster; see README.md
in this folder.
"""
