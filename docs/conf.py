"""Settings of Sphinx for the site; `docs.build` collects what it reads."""

import stringcast

project = "stringcast"
author = "the stringcast authors"
release = stringcast.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
source_suffix = {".md": "markdown"}
root_doc = "index"

# headings up to this depth can be linked to, as the public host of a clone does
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autosummary_generate = False
numpydoc_show_class_members = False

html_theme = "furo"
html_title = "stringcast"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["wrap.css"]
html_show_sphinx = False
# commands of pages are typed as they are
smartquotes = False
# a page shows commands with options for which no lexer exists
highlight_language = "none"
linkcheck_timeout = 20
