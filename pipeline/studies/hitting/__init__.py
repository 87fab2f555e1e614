"""How often casts hit: ways of casting compared on strings of the virtual bench, and
what a diagnosis is worth.
"""
