"""Poses from predicted keypoints, and how good they are."""
