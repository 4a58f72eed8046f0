"""Caches of the annotation server: scenes, pictures and masks."""
