"""The dataset card says what the files beside it hold."""

from __future__ import annotations

import json
import re
from pathlib import Path

from rpl_data.cli.main import main
from rpl_data.workspace.workspace import Workspace


def test_the_card_counts_what_the_files_hold(tiny_workspace: Workspace, tmp_path: Path) -> None:
    folder = tiny_workspace.export("coco")
    if not (folder / "README.md").exists():
        assert main(["export", "--workspace", str(tiny_workspace.root), "--again"]) == 0
    card = (folder / "README.md").read_text()
    assert "Licence: not stated" in card
    for split in ("train", "val", "test"):
        data = json.loads((folder / f"{split}.json").read_text())
        (images, shown) = re.findall(rf"^\| {split} \| (\d+) \| [^|]+ \| (\d+) \|$", card, re.M)[0]
        assert (int(images), int(shown)) == (len(data["images"]), len(data["annotations"]))
    model = tiny_workspace.model("carton")
    assert f"| carton | {len(model.keypoints)} keypoints: {', '.join(model.keypoints)} |" in card
    camera = tiny_workspace.load_scene("00").intrinsics
    assert f"| 00, 01, 02 | {camera.width} x {camera.height} | {camera.fx:.1f} |" in card
