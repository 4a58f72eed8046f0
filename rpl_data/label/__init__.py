"""Poses and the dense model -> labels of every frame (paper III-E)."""
