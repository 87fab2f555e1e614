"""The figures of a sweep, one file each: a `Picture`, or None where there is nothing to show."""
