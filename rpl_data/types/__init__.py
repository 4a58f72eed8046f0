"""The data types of rpl_data: what stages take and return.

Every stage takes and returns the frozen dataclasses below; most of them
are also files that `rpl_data/workspace/workspace.py` reads and writes. Conventions (frames, pixels, units)
are in `rpl_data/geometry.py`.

A missing value is absent, ``None``, or NaN in an array of numbers; never -1 or 0.
"""

from rpl_data.types.clicks import Click, Observation
from rpl_data.types.errors import DataError, UnsureError
from rpl_data.types.images import Box, ColorImage, DepthImage, DepthUnits, GreyImage, Rle, SquareBox, Window
from rpl_data.types.labels import Correction, FrameLabel, InstanceLabel, QualityRow
from rpl_data.types.network import NetworkView
from rpl_data.types.recording import (
    DepthCamera,
    DepthCoding,
    DepthWarp,
    Frame,
    Intrinsics,
    ReadDepth,
    ReadDepthInto,
    Recording,
    Scene,
    Span,
    Trajectory,
    posed_frames,
    spread_evenly,
)
from rpl_data.types.solution import (
    HINTS,
    ClickResidual,
    DepthState,
    KeypointModel,
    NextClick,
    PlacedHow,
    Placement,
    Solution,
    Statement,
    StatementKind,
    expected_mm,
)
from rpl_data.types.surfaces import Mesh, PointCloud
from rpl_data.types.symmetry import FoundAxis, Symmetries, SymmetryAxis, SymmetryRecord, Turns

__all__ = [
    "HINTS",
    "Box",
    "Click",
    "ClickResidual",
    "ColorImage",
    "Correction",
    "DataError",
    "DepthImage",
    "DepthState",
    "DepthUnits",
    "DepthCamera",
    "DepthCoding",
    "DepthWarp",
    "FoundAxis",
    "Frame",
    "FrameLabel",
    "GreyImage",
    "InstanceLabel",
    "Intrinsics",
    "KeypointModel",
    "Mesh",
    "NetworkView",
    "NextClick",
    "Observation",
    "PlacedHow",
    "Placement",
    "PointCloud",
    "QualityRow",
    "ReadDepth",
    "ReadDepthInto",
    "Recording",
    "Rle",
    "Scene",
    "Solution",
    "Span",
    "SquareBox",
    "Statement",
    "StatementKind",
    "Symmetries",
    "SymmetryAxis",
    "SymmetryRecord",
    "Turns",
    "Trajectory",
    "UnsureError",
    "Window",
    "expected_mm",
    "posed_frames",
    "spread_evenly",
]
