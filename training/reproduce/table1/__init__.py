"""Table I: errors of keypoints and masks."""
