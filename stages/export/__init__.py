"""Export of estimated strings to other programs."""
