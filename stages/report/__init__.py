"""Self-contained HTML pages: `page.py` has their parts, `charts/` their figures."""
