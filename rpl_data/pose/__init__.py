"""An object's pose from its keypoints in one image, and depth where there is some.

`estimate_pose` never guesses: what cannot be solved comes back as a `PoseFailure` that says why, so that a
caller can count it. It is never an identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from rpl_data.geometry import spread_m
from rpl_data.pose.correspondences import Correspondences, correspondences
from rpl_data.pose.estimate import Method, PoseEstimate, PoseFailure, estimate_pose
from rpl_data.pose.refine import covariance_of, refined, reprojection_sigmas
from rpl_data.pose.solvers import FEWEST, SOLVERS

__all__ = ["Correspondences", "Method", "PoseEstimate", "PoseFailure", "correspondences", "estimate_pose"]
