"""The annotation page: mark keypoints in a browser, and see at once how well they fit."""

from rpl_data.annotate.work import Address, Work

__all__ = ["Address", "Work"]
