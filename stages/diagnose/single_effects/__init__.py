"""A diagnosis as a sum of single effects (SuSiE: Wang, Sarkar, Carbonetto and Stephens 2020, JRSS B 82, 1273)."""
