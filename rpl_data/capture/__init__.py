"""Cameras: record from a RealSense, and read the files that its own tools record."""
