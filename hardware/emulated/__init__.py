"""Shared parts of emulated arms: wire-driven joints and a pseudo-terminal."""
