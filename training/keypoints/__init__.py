"""The stacked hourglass of one object's keypoints (paper IV-B)."""
