"""Which scenes a network was trained on, so that nobody takes them for scenes that it never saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rpl_data.files import file_hash
from rpl_data.formats.datasets.coco_parts import read_packed

from .folder import TRAINED_ON, read_checkpoint

IMAGES = {"annotations": (), "crowds": ()}
"""What of a COCO file is read: its images."""

Samples = Mapping[str, list[str]]
"""By scene, the file of one image, relative to the export, and its SHA-256; empty where it cannot be read."""


def scene_samples(coco_json: Path) -> dict[str, list[str]]:
    """One image of each scene in a file, by which the scene is known again."""
    firsts: dict[str, str] = {}
    for image in read_packed(coco_json, IMAGES)["images"]:
        firsts.setdefault(image["scene"], image["file_name"])
    return {scene: [name, _hash(coco_json.parent / name)] for scene, name in firsts.items()}


def trained_scenes(checkpoint: Path, coco_json: Path) -> list[str]:
    """The scenes in a file whose images a network was trained on, or chosen by.

    A scene of the same name in another recording has other images. Nothing is known of checkpoints of earlier
    versions, nor of the scenes that rendered images were made of.
    """
    run: Mapping[str, Any] = read_checkpoint(checkpoint).get("run", {})
    trained: Samples = run.get(TRAINED_ON, {})
    images = read_packed(coco_json, IMAGES)["images"]
    shown = {image["scene"] for image in images}
    return sorted(s for s in shown & set(trained) if _is_same(coco_json.parent, *trained[s]))


def say_trained(checkpoints: Iterable[Path], coco_json: Path) -> None:
    """Say of each network which scenes of a file it was trained on."""
    for checkpoint in checkpoints:
        if scenes := trained_scenes(checkpoint, coco_json):
            print(
                f"{checkpoint} was trained on scene {', '.join(scenes)}: what follows does not say how good "
                "it is in scenes that it never saw; train on the splits as they are now"
            )


def _is_same(folder: Path, name: str, digest: str) -> bool:
    return bool(digest) and _hash(folder / name) == digest


def _hash(image: Path) -> str:
    return file_hash(image) if image.is_file() else ""
