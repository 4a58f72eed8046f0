"""Mask R-CNN on an exported COCO file with torchvision and pycocotools alone; nothing of rpl-data.

python training/examples/plain_torchvision.py my-workspace/export/coco/train.json
"""

import argparse
from pathlib import Path

import torch
from pycocotools.coco import COCO
from torch import Tensor
from torchvision.io import decode_image
from torchvision.models.detection import maskrcnn_resnet50_fpn

Target = dict[str, Tensor]


class CocoInstances(torch.utils.data.Dataset[tuple[Tensor, Target]]):
    """Images and torchvision's targets."""

    def __init__(self, json_file: str) -> None:
        self.coco, self.folder = COCO(json_file), Path(json_file).parent
        self.ids = sorted(self.coco.getImgIds())

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, row: int) -> tuple[Tensor, Target]:
        entry = self.coco.loadImgs(self.ids[row])[0]
        annotations = self.coco.loadAnns(self.coco.getAnnIds(imgIds=entry["id"]))
        image = decode_image(str(self.folder / entry["file_name"]), mode="RGB") / 255
        masks = [torch.from_numpy(self.coco.annToMask(a)) for a in annotations]
        xywh = torch.tensor([a["bbox"] for a in annotations]).reshape(-1, 4)
        boxes = torch.cat([xywh[:, :2], xywh[:, :2] + xywh[:, 2:]], dim=1)
        labels = torch.tensor([a["category_id"] for a in annotations], dtype=torch.int64)
        empty = torch.zeros((0, *image.shape[1:]), dtype=torch.uint8)
        return image, {"boxes": boxes, "labels": labels, "masks": torch.stack(masks) if masks else empty}


def collate(batch: list[tuple[Tensor, Target]]) -> tuple[list[Tensor], list[Target]]:
    """Images and targets as two lists."""
    return [image for image, _ in batch], [target for _, target in batch]


def main() -> None:
    """Train from scratch and print the loss of every step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("json_file")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--size", type=int, default=512, help="shorter side of the image, pixels")
    options = parser.parse_args()
    data = CocoInstances(options.json_file)
    size = {"min_size": options.size, "max_size": 2 * options.size}
    model = maskrcnn_resnet50_fpn(weights_backbone=None, num_classes=len(data.coco.cats) + 1, **size)
    optimizer = torch.optim.SGD(model.parameters(), lr=1e-3, momentum=0.9)
    draw = torch.utils.data.RandomSampler(data, replacement=True, num_samples=2 * options.steps)
    loader = torch.utils.data.DataLoader(data, 2, sampler=draw, collate_fn=collate)
    for step, (images, targets) in enumerate(loader):
        loss = sum(model(images, targets).values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        print(f"step {step}: loss {loss.item():.4f}", flush=True)


if __name__ == "__main__":
    main()
