"""Report: self-contained HTML pages from what runs have made. `page.py` is what a page
is, `pages/` those there are, `charts/` what is drawn in them.
"""
