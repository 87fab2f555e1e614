"""Pages, a module each; a section is a function from a record to a `Section`."""
