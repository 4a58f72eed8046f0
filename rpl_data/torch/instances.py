"""Dataset of whole images with boxes, labels and masks, as torchvision's detection models take them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import cv2
from torch import Tensor
from torch.utils.data import Dataset, get_worker_info
from torchvision import tv_tensors

from rpl_data.formats.datasets.coco_parts import read_packed
from rpl_data.torch.image_files import read_image, to_unit_range
from rpl_data.torch.scenes import only_scenes
from rpl_data.torch.splits import split_file
from rpl_data.torch.targets import InstanceSample as InstanceSample
from rpl_data.torch.targets import InstanceTarget as InstanceTarget
from rpl_data.torch.targets import pair_of, rows_by_image, settled, target_of
from rpl_data.torch.transforms import Image
from rpl_data.wording import counted

IMAGE_KEYS = ("id", "file_name", "scene", "width", "height")
TARGET_KEYS = ("image_id", "category_id", "segmentation", "area", "bbox", "iscrowd", "keypoints")


class InstanceDataset(Dataset[InstanceSample]):
    """Every image of an exported dataset, with or without objects, with torchvision's detection targets.

    ::

        dataset = InstanceDataset("my-workspace/export/coco", split="train")
        image, target = dataset[0]
        DataLoader(dataset, batch_size=2, collate_fn=collate)    # images and targets as two lists

    `image` is float32, 3 x height x width, RGB, 0 to 1. `target` is a dictionary for n instances (n may be
    0):

    ==========  =======  =================  ==============================================================
    key         dtype    shape              what it is
    ==========  =======  =================  ==============================================================
    boxes       float32  n, 4               x0 y0 x1 y1 in px, COCO's edges, of the visible mask
    labels      int64    n                  category ids from 1; 0 is the background
    masks       uint8    n, height, width   1 = visible pixel of the object
    image_id    int                         of the COCO file
    area        float32  n                  visible pixels
    iscrowd     int64    n                  1 = a region marked as ignored, with `crowds=True`; else zeros
    keypoints   float32  n, k, 3            x y v in px; v: 0 not labelled, 1 hidden, 2 seen
    points      float32  n, k, 2            x y for transforms, counted from the edge; NaN where v is 0
    visibility  int64    n, k               v of the keypoints
    ==========  =======  =================  ==============================================================

    k is the number of keypoints of the object with most; the others' rows are padded with zeros. `keypoints`,
    which torchvision's Keypoint R-CNN reads, count from the centre of the first pixel; boxes and `points`,
    which torchvision's transforms move, from its edge. After `transforms`, `keypoints` follow `points` and
    `area` the masks, and instances without a visible pixel are dropped. Where you call transforms yourself,
    `settled` does the same.

    Attributes:
        names: name of each label; `names[0]` is the background.
    """

    def __init__(
        self,
        path: str | Path,
        transforms: Callable[[Tensor, InstanceTarget], InstanceSample] | None = None,
        *,
        split: str | None = None,
        crowds: bool = False,
        scenes: Collection[str] | None = None,
    ) -> None:
        """Read the annotations; images stay on disk.

        Args:
            path: the folder of an export (my-workspace/export/coco), or one of its JSON files.
            transforms: called with the image (float32, 3 x height x width, 0 to 1) and its target, both made
                of tv_tensors, so torchvision.transforms.v2 works, and so does `RandomAffine`. Do not flip:
                a mirrored object is another object (and torchvision moves keypoints one pixel too far).
            split: train, val or test, when `path` is a folder.
            crowds: whether to give regions that a person marked as ignored in a labelling tool as well, with
                `iscrowd` 1. That is for evaluators: torchvision's models would learn them as objects.
            scenes: only the images of these; None for all.

        Raises:
            DataError: there is no such split (the message says why), or the file is not an export of
                rpl-data.
        """
        coco_json = split_file(path, split)
        self._coco_json = coco_json
        keys = {"images": IMAGE_KEYS, "annotations": TARGET_KEYS, "crowds": TARGET_KEYS}
        data = only_scenes(read_packed(coco_json, keys), scenes)
        by_id = sorted(data["categories"], key=lambda category: int(category["id"]))
        self.names = ["background", *(category["name"] for category in by_id)]
        self._most_keypoints = max((len(c["keypoints"]) for c in data["categories"]), default=0)
        self._folder, self._transforms = coco_json.parent, transforms
        self._images = data["images"]
        self._annotations = data["annotations"]
        self._crowds = data.get("crowds", ()) if crowds else ()
        self._rows_of = rows_by_image(self._annotations)
        self._crowds_of = rows_by_image(self._crowds)

    def __repr__(self) -> str:
        return (
            f"InstanceDataset({str(self._coco_json)!r}): {counted(len(self), 'image')} of "
            f"{', '.join(self.names[1:])}"
        )

    def __len__(self) -> int:
        """Number of images."""
        return len(self._images)

    def labelled(self) -> int:
        """How many instances the images show, without regions that are ignored."""
        return len(self._annotations)

    def image_id(self, row: int) -> int:
        """The id that an image has in the COCO file."""
        return int(self._images[row]["id"])

    def __getitem__(self, row: int) -> InstanceSample:
        """Return an image and its target."""
        pixels, target = self.read(row)
        image = tv_tensors.Image(to_unit_range(pixels))
        if self._transforms is None:
            return image, target
        image, target = pair_of(self._transforms(image, target))
        return image, settled(target)

    def size(self, row: int) -> tuple[int, int]:
        """Return the width and height of an image in pixels."""
        return self._images[row]["width"], self._images[row]["height"]

    def read(self, row: int, *, halved: bool = False) -> tuple[Image, InstanceTarget]:
        """Return an image (RGB; at half its size if `halved`) and the target at full size, untransformed."""
        if get_worker_info() is not None:
            cv2.setNumThreads(0)  # see KeypointDataset.__getitem__
        file = str(self._folder / self._images[row]["file_name"])
        return read_image(file, halved=halved, size=self.size(row)), self.target(row)

    def target(self, row: int) -> InstanceTarget:
        """Return the target of an image at full size, untransformed, without reading the image."""
        entry = self._images[row]
        shown = [self._annotations[number] for number in self._rows_of.get(entry["id"], ())]
        shown += [self._crowds[number] for number in self._crowds_of.get(entry["id"], ())]
        return target_of(entry, shown, self._most_keypoints)


def collate(batch: Sequence[InstanceSample]) -> tuple[list[Tensor], list[InstanceTarget]]:
    """Return images and targets as two lists, as torchvision's detection models take them."""
    return [image for image, _ in batch], [target for _, target in batch]
