"""Recordings as other tools and datasets lay them out, one reader per layout."""
