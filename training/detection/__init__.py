"""The detector of all objects of a dataset."""
