"""The figures of the report, one file each: a function from artifacts to a `Picture`, or None where
the data it shows are missing (the page then says so)."""
