"""Pages, a module each: a section is a function from the record to a `Section` of
parts.
"""
