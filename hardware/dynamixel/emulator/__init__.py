"""Emulated servos on a pseudo-terminal, for use with the maker's library."""
