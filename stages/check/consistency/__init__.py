"""Consistency of hand, string and clocks, and corrections of common mistakes."""
