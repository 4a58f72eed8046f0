"""Cameras: recording from a RealSense, and reading the files that its tools record."""
