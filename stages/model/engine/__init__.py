"""The step loop that moves the string: source text, time steps and threads."""
