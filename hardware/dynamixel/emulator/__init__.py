"""A bus of servos on a pseudo-terminal, which answers the packets of the maker's own
library.
"""
