"""A bus of emulated servos on a pseudo-terminal for the maker's own library."""
