"""Clicks: their log, lifting to rays with candidate depths (Eq. 1), the rigidity test, and grasp frames."""
