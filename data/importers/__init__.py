"""Files of other programs, read into plain tables of named columns; `columns` says what a column means by its name, and
`gathered` makes of them the tables of our own format. A file format is a file here, with `reads` and `read`."""
