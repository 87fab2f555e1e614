"""Self-contained HTML pages: `parts.py` has their parts, `charts/` their figures."""
