"""Readers of recordings in the layouts of other tools and datasets, one per layout."""
