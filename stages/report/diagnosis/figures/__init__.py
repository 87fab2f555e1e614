"""The figures of a diagnosis, one file each: a function from a record to a `Picture`, or None where there is nothing
to show."""
