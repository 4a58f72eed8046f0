"""Estimate an object's pose from its keypoints in one image, and from depth where it is known.

`estimate_pose` never guesses: what cannot be solved is returned as a `PoseFailure` that says why, so that the
caller can count it. It never returns an identity instead.
"""

from rpl_data.pose.correspondences import Correspondences, correspondences
from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure, estimate_pose

__all__ = ["Correspondences", "Method", "PoseEstimate", "PoseFailure", "correspondences", "estimate_pose"]
