"""Tables and their schemas, the store that keeps them, importers and sample data."""
