"""Whether a dense model was carved: what shape and colours say of an object does not hold for such a one."""

from __future__ import annotations

from rpl_data.pipeline.ledger import Ledger
from rpl_data.workspace.workspace import Workspace


def is_carved(workspace: Workspace, name: str) -> bool:
    """Whether no camera measured any of the surface of an object's dense model (`segment.carving`)."""
    made = Ledger(workspace.stages_file).entries.get(f"segment/{name}")
    details = made.outcome.details if made else {}
    return "unseen_triangles" in details and bool(details["unseen_triangles"] == details["triangles"])
