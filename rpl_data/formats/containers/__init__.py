"""Containers: single files that hold a whole recording. These modules read bytes, not yet scenes."""
