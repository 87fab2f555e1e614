"""Pictures by topic; each a `Picture`, or None where there is nothing to draw."""
