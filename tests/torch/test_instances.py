"""InstanceDataset: torchvision's targets, empty frames, and a step of Mask R-CNN."""

import numpy as np
import pytest
import torch
from labelled_scenes import CAMERA, LAST_FRAME, exported
from pycocotools import mask as masks
from torch.utils.data import DataLoader
from torchvision import tv_tensors
from torchvision.transforms import v2

from rpl_data.formats.datasets.coco import read_coco
from rpl_data.torch.instances import InstanceDataset, InstanceTarget, collate
from rpl_data.torch.transforms import Augmentation, crop_from_square, moved
from rpl_data.torch.warps import RandomAffine, warp_instances, warp_pixels


@pytest.fixture(scope="module")
def coco(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("instances")) / "train.json"


def test_shown_at_a_prompt(coco):
    assert repr(InstanceDataset(coco)).endswith(
        f"train.json'): {len(InstanceDataset(coco))} images of box, can"
    )


def test_targets_are_the_annotations(coco):
    dataset, data = InstanceDataset(coco), read_coco(coco)
    assert dataset.names == ["background", "box", "can"] and len(dataset) == len(data["images"]) == 6
    for row, entry in enumerate(data["images"]):
        image, target = dataset[row]
        mine = [a for a in data["annotations"] if a["image_id"] == entry["id"]]
        assert set(target) == set(InstanceTarget.__annotations__)
        assert image.shape == (3, CAMERA.height, CAMERA.width) and image.dtype == torch.float32
        assert target["image_id"] == entry["id"]
        assert target["labels"].tolist() == [a["category_id"] for a in mine]
        assert target["area"].tolist() == [a["area"] for a in mine]
        assert target["masks"].sum(dim=(1, 2)).tolist() == [a["area"] for a in mine]
        for box, mask, a in zip(target["boxes"], target["masks"], mine, strict=True):
            x, y, width, height = a["bbox"]
            assert box.tolist() == [x, y, x + width, y + height]
            np.testing.assert_array_equal(mask, masks.decode(a["segmentation"]))


def test_empty_frame_has_empty_tensors(coco):
    image, target = InstanceDataset(coco)[0]
    assert target["boxes"].shape == (0, 4) and target["boxes"].dtype == torch.float32
    assert target["masks"].shape == (0, CAMERA.height, CAMERA.width) and target["masks"].dtype == torch.uint8
    assert target["labels"].shape == (0,) and target["labels"].dtype == torch.int64
    assert target["area"].shape == (0,) and target["iscrowd"].shape == (0,)
    assert target["iscrowd"].dtype == torch.int64 and target["keypoints"].shape == (0, 4, 3)


def test_boxes_masks_and_image_are_tv_tensors(coco):
    image, target = InstanceDataset(coco)[1]
    assert isinstance(image, tv_tensors.Image)
    assert isinstance(target["masks"], tv_tensors.Mask)
    assert isinstance(target["boxes"], tv_tensors.BoundingBoxes)
    assert target["boxes"].canvas_size == (CAMERA.height, CAMERA.width)
    resized, moved_target = InstanceDataset(coco, transforms=v2.Resize((60, 80)))[1]
    assert resized.shape == (3, 60, 80) and moved_target["masks"].shape[1:] == (60, 80)
    torch.testing.assert_close(torch.Tensor(moved_target["boxes"]), torch.Tensor(target["boxes"]) / 2)


def test_workers(coco):
    loader = DataLoader(InstanceDataset(coco), batch_size=3, num_workers=2, collate_fn=collate)
    batches = list(loader)
    assert [len(images) for images, _ in batches] == [3, 3]
    assert [len(t["labels"]) for _, targets in batches for t in targets] == [0, 2, 2, 2, 2, 2]


def test_everything_moves_together(coco):
    image, target = InstanceDataset(coco)[LAST_FRAME]
    shift = np.array([[1.0, 0, 5], [0, 1, -3]])
    shifted, there = warp_instances(image, target, shift)
    torch.testing.assert_close(shifted[:, :-3, 5:], image[:, 3:, :-5], rtol=0, atol=1e-6)
    assert torch.equal(there["masks"][:, :-3, 5:], target["masks"][:, 3:, :-5])
    torch.testing.assert_close(
        torch.Tensor(there["boxes"]), torch.Tensor(target["boxes"]) + torch.tensor([5.0, -3, 5, -3])
    )
    seen = target["keypoints"][..., 2] > 0
    step = torch.tensor([5.0, -3, 0])
    torch.testing.assert_close(there["keypoints"][seen], target["keypoints"][seen] + step)
    assert there["keypoints"][~seen].abs().sum() == 0
    torch.testing.assert_close(there["area"], target["area"])


def test_turned_keypoints_stay_on_their_mask_and_boxes_hold_masks(coco):
    image, target = InstanceDataset(coco)[LAST_FRAME]
    centre = np.array([79.5, 59.5])
    turn = crop_from_square(centre, 160.0, input_px=160, rotation_rad=0.5)
    turn[:, 2] += centre - 79.5
    np.testing.assert_allclose(moved(turn, centre), centre)
    _, there = warp_instances(image, target, turn)
    for box, mask, area in zip(there["boxes"], there["masks"], there["area"], strict=True):
        x0, y0, x1, y1 = box.int().tolist()
        assert mask[y0:y1, x0:x1].sum() == mask.sum() == area
        assert mask[y0].any() and mask[y1 - 1].any() and mask[:, x0].any() and mask[:, x1 - 1].any()
    assert there["area"].sum() == pytest.approx(float(target["area"].sum()), rel=0.03)


def test_instances_that_leave_the_image_leave_the_target(coco):
    image, target = InstanceDataset(coco)[1]
    _, gone = warp_instances(image, target, np.array([[1.0, 0, 500], [0, 1, 0]]))
    assert gone["boxes"].shape == (0, 4) and gone["masks"].shape == (0, CAMERA.height, CAMERA.width)
    assert gone["keypoints"].shape == (0, 4, 3) and gone["labels"].shape == (0,)


def test_random_affine_repeats_with_the_seed(coco):
    dataset = InstanceDataset(coco, transforms=RandomAffine(Augmentation()))
    torch.manual_seed(0)
    first = [dataset[row] for row in range(len(dataset))]
    torch.manual_seed(0)
    again = [dataset[row] for row in range(len(dataset))]
    for (a, target), (b, other) in zip(first, again, strict=True):
        assert torch.equal(a, b) and torch.equal(target["boxes"], other["boxes"])
        assert a.shape == (3, CAMERA.height, CAMERA.width)


def test_mask_rcnn_trains_a_step(coco):
    from torchvision.models.detection import MaskRCNN
    from torchvision.models.detection.backbone_utils import resnet_fpn_backbone

    torch.manual_seed(0)
    backbone = resnet_fpn_backbone(
        backbone_name="resnet18", weights=None, norm_layer=torch.nn.BatchNorm2d, trainable_layers=5
    )
    model = MaskRCNN(
        backbone,
        num_classes=3,
        min_size=64,
        max_size=96,
        rpn_pre_nms_top_n_train=50,
        box_batch_size_per_image=16,
    )
    optimizer = torch.optim.SGD(model.parameters(), lr=1e-3)
    # The first batch holds the frame without an object.
    images, targets = next(iter(DataLoader(InstanceDataset(coco), batch_size=2, collate_fn=collate)))
    losses = model(images, targets)
    total = sum(losses.values())
    total.backward()
    optimizer.step()
    assert len(losses) == 5 and all(torch.isfinite(loss) for loss in losses.values()) and total < 100


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_halved_image_shows_the_same(tmp_path, suffix):
    dataset = InstanceDataset(exported(tmp_path, suffix=suffix) / "train.json")
    whole, target = dataset.read(LAST_FRAME)
    half, same = dataset.read(LAST_FRAME, halved=True)
    assert half.shape == (CAMERA.height // 2, CAMERA.width // 2, 3)
    assert torch.equal(target["masks"], same["masks"])
    means = whole.reshape(CAMERA.height // 2, 2, CAMERA.width // 2, 2, 3).mean(axis=(1, 3))
    assert abs(half - means).mean() < 1
    assert dataset.size(LAST_FRAME) == (CAMERA.width, CAMERA.height)
    crop = crop_from_square(np.array([70.0, 60.0]), 120.0, input_px=48, rotation_rad=0.1)
    seen, there = warp_pixels(whole, target, crop, size=(48, 48))
    seen_halved, there_halved = warp_pixels(half, same, crop, size=(48, 48), halved=True)
    assert torch.equal(there["masks"], there_halved["masks"]) and len(there["labels"]) == 2
    shift = (seen[:, :, 1:] - seen[:, :, :-1]).abs().mean()  # what an error of a pixel would change
    assert (seen - seen_halved).abs().mean() < 0.15 * shift
