"""The tables and the document of a diagnosis."""
