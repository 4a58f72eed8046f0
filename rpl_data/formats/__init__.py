"""Formats of other tools: one module per format, with its reader and its writer together."""
