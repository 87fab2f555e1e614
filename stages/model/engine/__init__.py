"""The step loop that moves the string: its source text, its time steps and its threads."""
