"""The annotation page: a person marks keypoints in a browser and sees at once how good the result is."""

from rpl_data.annotate.work import Place, Work

__all__ = ["Place", "Work"]
