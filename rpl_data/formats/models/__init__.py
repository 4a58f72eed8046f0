"""Models of objects that other tools write: keypoints, picked points, surfels."""
