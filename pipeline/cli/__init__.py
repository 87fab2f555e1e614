"""The command line and the terminal: help, hints on mistakes, messages, summaries."""
