"""The page of a check, and the picture of what was measured."""
