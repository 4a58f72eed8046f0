"""The masks of one recording, matched to its frames by name.

================  ==================================================================================
`png`             `<frame>.png`, 0 and 255, or a number per object, grey or by palette: what Cutie and
                  XMem write to `masks/`, and SAM 2's `vos_inference.py`
`folders`         `<object>/<frame>.png`, not 0 on the object: SAM 2's `--per_obj_png_file` (`001/`)
`coco`            a JSON file with polygons or run lengths, a category per object
================  ==================================================================================

Sources: facebookresearch/sam2, tools/vos_inference.py (`save_palette_masks_to_dir`, `save_masks_to_dir`);
hkchengrex/Cutie, `process_video.py` and the `masks` folder of its workspaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from rpl_data.files import decoding, read_json
from rpl_data.formats.datasets.coco_edited import packed_mask
from rpl_data.formats.masks.ids import read_ids
from rpl_data.types import DataError, Scene
from rpl_data.wording import counted

MaskFormat = Literal["png", "folders", "coco"]
MaskImage = Bool[np.ndarray, "height width"]
Masks = Mapping[str, MaskImage]
"""The masks of one frame, by the key of the object in the files: its number, folder or category."""
REMEDY = "write the masks again, or correct `masks:` of the scene in the recipe"


@dataclass(frozen=True)
class GivenMasks:
    """Masks of a recording, opened when they are asked for.

    Attributes:
        readers: by frame index, what reads the masks of that frame.
        notes: lines for the user: frames without masks, masks without frames.
    """

    readers: Mapping[int, Callable[[], Masks]]
    notes: tuple[str, ...]

    def at(self, frame: int) -> Masks | None:
        """The masks of a frame; None where there are none. DataError when a file is damaged."""
        return self.readers[frame]() if frame in self.readers else None


def open_masks(path: Path, kind: MaskFormat, scene: Scene, *, alone: bool = True) -> GivenMasks:
    """Find the masks of a recording.

    Args:
        path: a folder or a JSON file; when it has an entry with the name of the scene, that one counts.
        alone: no other scene has its masks there, so that what is not named by scene is of this one.

    Raises:
        DataError: there are none, or none whose name is that of a frame.
    """
    named = path / (f"{scene.name}.json" if kind == "coco" else scene.name)
    here = named if path.is_dir() and named.exists() else path
    if not here.exists():
        raise DataError(f"the masks of scene {scene.name}: {here} does not exist; {REMEDY}")
    if not alone and here == path and kind != "coco":
        raise DataError(
            f"the masks of scene {scene.name}: {path} is named for several scenes; expected a folder per "
            f"scene in it, such as {named}; sort them into folders"
        )
    found = FINDERS[kind](here, scene, alone or here != path)
    frames = _matched(found, scene, here)
    unmatched, without = len(found) - len(frames), len(scene.frames) - len(frames)
    notes = []
    if without:
        notes.append(f"{counted(without, 'frame')} of {len(scene.frames)} have no given mask")
    if unmatched:
        notes.append(f"{counted(unmatched, 'given mask')} left out: named like no frame")
    return GivenMasks(frames, tuple(notes))


def _matched(
    found: Mapping[str, Callable[[], Masks]], scene: Scene, path: Path
) -> dict[int, Callable[[], Masks]]:
    """The readers by frame: of the same name without suffix, else of the same number.

    Raises:
        DataError: no name fits, or the masks are counted from another number than the frames.
    """
    stems = {frame.color.stem: frame.index for frame in scene.frames}
    counted_alike = all(map(str.isdecimal, (*stems, *found)))
    if counted_alike and len(found) == len(stems) and set(map(int, found)) != set(map(int, stems)):
        raise DataError(
            f"the masks of scene {scene.name}: {path} has as many as there are frames, but numbers "
            f"{min(found, key=int)} to {max(found, key=int)} where the frames have {min(stems, key=int)} to "
            f"{max(stems, key=int)}; rename them like their colour images"
        )
    by_name = {stems[stem]: read for stem, read in found.items() if stem in stems}
    if by_name:
        return by_name
    if counted_alike:
        numbers = {int(stem): index for stem, index in stems.items()}
        by_number = {numbers[int(stem)]: read for stem, read in found.items() if int(stem) in numbers}
        if by_number:
            return by_number
    raise DataError(
        f"the masks of scene {scene.name}: none in {path} is named like a frame; expected names such as "
        f"{min(stems, default='-')}, found {min(found, default='none')}; rename them"
    )


def _size(scene: Scene) -> tuple[int, int]:
    """Height and width of the colour images."""
    return scene.intrinsics.height, scene.intrinsics.width


def _png(folder: Path, scene: Scene, alone: bool) -> dict[str, Callable[[], Masks]]:
    def reader(file: Path) -> Callable[[], Masks]:
        def read() -> Masks:
            ids = read_ids(file, size=_size(scene))
            return {str(number): ids == number for number in np.unique(ids) if number}

        return read

    return {file.stem: reader(file) for file in sorted(folder.glob("*.png"))}


def _folders(folder: Path, scene: Scene, alone: bool) -> dict[str, Callable[[], Masks]]:
    files: dict[str, dict[str, Path]] = {}
    for file in sorted(folder.glob("*/*.png")):
        files.setdefault(file.stem, {})[file.parent.name] = file

    def reader(of_frame: Mapping[str, Path]) -> Callable[[], Masks]:
        return lambda: {key: read_ids(file, size=_size(scene)) > 0 for key, file in of_frame.items()}

    return {stem: reader(of_frame) for stem, of_frame in files.items()}


def _coco(file: Path, scene: Scene, alone: bool) -> dict[str, Callable[[], Masks]]:
    """The images of the scene; all where it is alone and none is of a scene of that name."""
    data = read_json(file)
    with decoding(file, REMEDY):
        names = {category["id"]: str(category["name"]) for category in data["categories"]}
        images = [image for image in data["images"] if _scene_of(image) == scene.name]
        if not images and alone:
            images = data["images"]
        entries: dict[Any, list[Any]] = {image["id"]: [] for image in images}
        for annotation in data["annotations"]:
            if annotation["image_id"] in entries:
                entries[annotation["image_id"]].append(annotation)

        def reader(image: Any) -> Callable[[], Masks]:
            return lambda: _of_image(image, entries[image["id"]], names, _size(scene), file)

        called = {frame.index: frame.color.stem for frame in scene.frames}
        readers: dict[str, Callable[[], Masks]] = {}
        for image in images:
            # Exports of ours call images by the index of the frame, whatever the recording calls them.
            ours = "scene" in image and image.get("frame") in called
            stem = called[image["frame"]] if ours else Path(image["file_name"]).stem
            if stem in readers:
                raise ValueError(f"two images are called {stem}: say in `scene` of each which scene it is of")
            readers[stem] = reader(image)
        return readers


def _scene_of(image: Any) -> str:
    """The scene that an image of a COCO file belongs to: as it says, or the folder it is in."""
    return str(image["scene"] if "scene" in image else Path(image["file_name"]).parent.name)


def _of_image(
    image: Any, annotations: list[Any], names: Mapping[Any, str], size: tuple[int, int], file: Path
) -> Masks:
    """The masks of an image by category; several of one category are joined."""
    from pycocotools import mask as coco_masks

    where = f"{file}: image {image['file_name']}"
    if (image["height"], image["width"]) != size:
        raise DataError(
            f"{where} has {image['width']} x {image['height']} px; expected {size[1]} x {size[0]}, as the "
            f"recording; {REMEDY}"
        )
    joined: dict[str, MaskImage] = {}
    for annotation in annotations:
        with decoding(f"{where}, annotation {annotation.get('id')}", REMEDY):
            mask = coco_masks.decode(packed_mask(annotation["segmentation"], size)) > 0
            key = names[annotation["category_id"]]
        joined[key] = joined[key] | mask if key in joined else mask
    return joined


FINDERS: Mapping[MaskFormat, Callable[[Path, Scene, bool], dict[str, Callable[[], Masks]]]] = {
    "png": _png,
    "folders": _folders,
    "coco": _coco,
}
"""What finds the masks of each format: readers by the name of their frame; whether all are of this scene."""
