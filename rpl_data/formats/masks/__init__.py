"""Masks of a recording that another program made, such as SAM 2, Cutie or an annotation tool."""
