"""Surfaces of the scenes -> the dense model of an object (paper III-D)."""
