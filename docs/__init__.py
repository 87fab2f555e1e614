"""The site: its settings, its front page, and what builds it."""
