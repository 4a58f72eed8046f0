"""The two label sources of the paper's experiments in one workspace: ours, and the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpl_data.files import read_json
from rpl_data.types import DataError

Source = Literal["OURS", "MANUAL"]
EXPORTS: dict[Source, str] = {"OURS": "coco", "MANUAL": "coco_truth"}


def exports_of(workspace: Path) -> dict[Source, Path]:
    """Find the folders of the two label sources; true labels that are missing or of other images are made."""
    from rpl_data.pipeline.build import context_of
    from rpl_data.pipeline.exported_labels import export_truth
    from rpl_data.workspace.workspace import Workspace

    place = Workspace(workspace)
    folders = {source: place.export(name) for source, name in EXPORTS.items()}
    if not folders["OURS"].exists():
        raise DataError(f"{workspace} has no export/coco; run `rpl build` with `export: [coco]`")
    if not same_images(*folders.values()):
        export_truth(context_of(place))
    return folders


def same_images(ours: Path, manual: Path) -> bool:
    """Whether both exports have the same images in each split: not where one was split anew since."""

    def files(export: Path, split: str) -> set[str] | None:
        path = export / f"{split}.json"
        return {str(image["file_name"]) for image in read_json(path)["images"]} if path.exists() else None

    return all(files(ours, split) == files(manual, split) for split in ("train", "val", "test"))
