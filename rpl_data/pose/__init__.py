"""An object's pose from its keypoints in one image, and depth where there is some.

`estimate_pose` never guesses: what cannot be solved comes back as a `PoseFailure` that says why, so that a
caller can count it. It is never an identity.
"""

from rpl_data.pose.correspondences import Correspondences, correspondences
from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure, estimate_pose

__all__ = ["Correspondences", "Method", "PoseEstimate", "PoseFailure", "correspondences", "estimate_pose"]
