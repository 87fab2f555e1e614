"""Studies: many runs from one description, of which tables, pictures and a sentence are
made.
"""
