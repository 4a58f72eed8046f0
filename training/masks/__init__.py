"""Mask R-CNN on the exported masks (paper IV-C)."""
