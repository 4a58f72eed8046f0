"""Segmentation of an object from the surfaces of its scenes: the dense model (paper III-D)."""
