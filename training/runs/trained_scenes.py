"""Which scenes a network was trained on, so that nobody takes them for scenes that it never saw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rpl_data.files import decoding, file_hash
from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.formats.datasets.scene_samples import Samples, samples_by_scene

from .folder import TRAINED_ON, read_checkpoint, reading_checkpoint
from .weights import IMAGENET, SCRATCH

LOOKED_AT = {"annotations": (), "crowds": ()}
"""What of a COCO file is read: its images."""


def scene_samples(coco_json: Path) -> Samples:
    """Some images of each scene in a file, and of those that its views were rendered from."""
    data = read_packed(coco_json, LOOKED_AT)
    with decoding(coco_json, "run `rpl synthesize` again"):
        made_of = data["rpl"].get("synthetic", {}).get("images_of", {})
        rendered = {scene: [[str(name), str(digest)] for name, digest in made_of[scene]] for scene in made_of}
    return joined(samples_by_scene(coco_json.parent, data["images"]), rendered)


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
    """The scenes of both whose images are not the same: a file that both name has no content in common."""
    return [scene for scene in before if _differ(before[scene], now.get(scene, []))]


def _differ(before: list[list[str]], now: list[list[str]]) -> bool:
    names = {name for name, _ in before} & {name for name, _ in now}
    same = {name for name, digest in before if [name, digest] in now}
    return bool(names - same)


def trained_scenes(checkpoint: Path, coco_json: Path) -> list[str]:
    """The scenes in a file that were in the training split of a network, or of one whose weights it took.

    So are scenes that its views were rendered from. A scene of the same name in another recording has other
    images.
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
                f"{checkpoint} was trained on scene {', '.join(scenes)} or views of it, or chosen by it: "
                "what follows does not say how good it is in scenes that it never saw; train on the splits "
                "as they are now"
            )


def _is_there(image: Path, digest: str) -> bool:
    return image.is_file() and file_hash(image) == digest
