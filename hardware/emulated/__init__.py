"""Shared parts of emulated arms: joints that hang by wires, and a pseudo-terminal."""
