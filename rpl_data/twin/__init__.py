"""Exact-truth RGB-D recordings of made-up scenes: objects, scene, trajectory, renderer, sensor, annotator."""

from rpl_data.twin.spec import TwinSpec
from rpl_data.twin.write import write_twin

__all__ = ["TwinSpec", "write_twin"]
