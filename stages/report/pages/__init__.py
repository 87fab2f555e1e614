"""Pages, one module each; a function builds each `Section` from a record."""
