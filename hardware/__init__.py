"""Arms and cameras, real and virtual. Nothing in `stages` imports this package."""
