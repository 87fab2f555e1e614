"""Runs: experiments, steps, results and their folders."""
