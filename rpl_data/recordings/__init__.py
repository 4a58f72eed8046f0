"""Recordings of any format, opened and put right."""
