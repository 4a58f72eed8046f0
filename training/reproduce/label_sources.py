"""The two label sources of the paper's experiments in one workspace: ours, and the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpl_data.types import DataError

Source = Literal["OURS", "MANUAL"]
EXPORTS: dict[Source, str] = {"OURS": "coco", "MANUAL": "coco_truth"}


def exports_of(workspace: Path) -> dict[Source, Path]:
    """Find the folders of the two label sources; the true labels are exported when they are not there yet."""
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.exported_labels import export_truth
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    folders = {source: place.export(name) for source, name in EXPORTS.items()}
    if not folders["OURS"].exists():
        raise DataError(f"{workspace} has no export/coco; run `rpl build` with `export: [coco]`")
    if not folders["MANUAL"].exists():
        export_truth(context_of(place))
    return folders
