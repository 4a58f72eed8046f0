"""Segmentation of an object from the surfaces of its scenes: the dense model (paper III-D)."""

from __future__ import annotations

from rpl_data.segment.segment import segment_object
from rpl_data.segment.smooth_model import join_smooth_regions

METHODS = {"convex": segment_object, "smooth": join_smooth_regions}
"""The ways to make the dense model, by their name in a recipe."""
