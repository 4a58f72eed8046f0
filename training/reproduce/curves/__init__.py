"""Error against the number of scenes and of keypoints."""
