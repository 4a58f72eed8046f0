"""Which scenes a network was trained on, so that nobody takes them for scenes that it never saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rpl_data.files import file_hash
from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.types import spread_evenly

from .folder import TRAINED_ON, read_checkpoint, reading_checkpoint
from .weights import IMAGENET, SCRATCH

LOOKED_AT = {"annotations": (), "crowds": ()}
"""What of a COCO file is read: its images."""
SAMPLES = 5
"""Images of a scene by which it is known again: some of them may be left out of a later export."""

Samples = dict[str, list[list[str]]]
"""By scene, files of some of its images, relative to the export, each with its SHA-256."""


def scene_samples(coco_json: Path) -> Samples:
    """Some images of each scene in a file; those that cannot be read are left out."""
    files: dict[str, list[str]] = {}
    for image in read_packed(coco_json, LOOKED_AT)["images"]:
        files.setdefault(image["scene"], []).append(image["file_name"])
    return {
        scene: [
            [name, file_hash(coco_json.parent / name)]
            for name in spread_evenly(names, SAMPLES)
            if (coco_json.parent / name).is_file()
        ]
        for scene, names in files.items()
    }


def samples_of(checkpoint: Path) -> Samples:
    """The images of the scenes that a network was trained on; nothing is known of earlier versions."""
    content = read_checkpoint(checkpoint)
    with reading_checkpoint(checkpoint, "a checkpoint of a training"):
        run: Mapping[str, Any] = content.get("run", {})
        return {
            scene: [[name, digest] for name, digest in run[TRAINED_ON][scene]]
            for scene in run.get(TRAINED_ON, {})
        }


def samples_before(resumed: Path | None, weights: str) -> Samples:
    """Those of the training that goes on, or of the one whose weights are taken."""
    if resumed is not None:
        return samples_of(resumed)
    return {} if weights in (SCRATCH, IMAGENET) else samples_of(Path(weights))


def joined(before: Samples, now: Samples) -> Samples:
    """The samples of both."""
    return {
        scene: [*now.get(scene, []), *(one for one in before.get(scene, []) if one not in now.get(scene, []))]
        for scene in {**before, **now}
    }


def other_images(before: Samples, now: Samples) -> list[str]:
    """The scenes of both whose images are not the same."""
    return [
        scene
        for scene in before
        if any(dict(now.get(scene, [])).get(name, digest) != digest for name, digest in before[scene])
    ]


def trained_scenes(checkpoint: Path, coco_json: Path) -> list[str]:
    """The scenes in a file that were in the training split of a network, or of one whose weights it took.

    A scene of the same name in another recording has other images. Of images that were rendered, nothing says
    which scenes they were made of.
    """
    trained = samples_of(checkpoint)
    shown = {image["scene"] for image in read_packed(coco_json, LOOKED_AT)["images"]}
    return sorted(
        scene
        for scene in shown & set(trained)
        if any(_is_there(coco_json.parent / name, digest) for name, digest in trained[scene])
    )


def say_trained(checkpoints: Iterable[Path], coco_json: Path) -> None:
    """Say of each network which scenes of a file it was trained on."""
    for checkpoint in checkpoints:
        if scenes := trained_scenes(checkpoint, coco_json):
            print(
                f"{checkpoint} was trained on scene {', '.join(scenes)}, or chosen by it: what follows does "
                "not say how good it is in scenes that it never saw; train on the splits as they are now"
            )


def _is_there(image: Path, digest: str) -> bool:
    return image.is_file() and file_hash(image) == digest
