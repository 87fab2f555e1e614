"""Charts by subject: each function returns a `Picture`, or None if there is no data."""
