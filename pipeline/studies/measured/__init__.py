"""Strings that others measured, fitted with stated sets of effects: how near does each
set come?
"""
