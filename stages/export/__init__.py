"""What was learned of a string, for other programs."""
