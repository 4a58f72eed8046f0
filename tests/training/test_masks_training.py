"""Mask R-CNN: the network, its training and what it refuses."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from labelled_scenes import CAMERA, exported, rle
from torchvision.models import resnet18
from torchvision.models.detection import maskrcnn_resnet50_fpn

from rpl_data.torch.instances import InstanceDataset
from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.masks.crops import SMALLEST_PX, SquareCrops, random_square
from training.masks.mask_rcnn import ModelConfig, build_model, train_body, with_norm
from training.masks.module import CHECKPOINT, train
from training.masks.results import predict
from training.masks.settings import Settings, learning_rate, load_settings
from training.masks.weights import Segmenter, load_segmenter, load_weights

ROOT = Path(__file__).parents[2]
SMALL = ModelConfig(
    backbone="resnet18", size_px=64, channels=32, hidden=64, proposals=50, rois=16, norm="batch"
)
QUICK = Settings(
    model=SMALL, weights="scratch", epochs=2, head_epochs=1, optimizer="adamw", warmup_steps=2, workers=0,
    accelerator="cpu",
)  # fmt: skip


@pytest.fixture(scope="module")
def coco(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("masks"))


def preset(name):
    return load_settings(ROOT / f"training/configs/masks_{name}.yaml")


def losses_of(out):
    rows = []
    for file in sorted(out.glob("csv/*/metrics.csv")):
        with file.open() as lines:
            rows += [
                (row["step"], row["loss"], row["loss_mask"], row["rate"]) for row in csv.DictReader(lines)
            ]
    return [row for row in rows if row[1]]


def batch_of(coco, size_px=64):
    crops = SquareCrops(coco / "train.json", size_px, Augmentation(shift=0.0), seed=0)
    samples = [crops[row] for row in range(2, 4)]
    return [image for image, _ in samples], [target for _, target in samples]


def rewritten(coco, folder, change):
    """The export with other annotations: `change` gets an image and its annotations and returns them."""
    data = json.loads((coco / "train.json").read_text())
    annotations = []
    for image in data["images"]:
        image["file_name"] = str(coco / image["file_name"])
        annotations += change(image, [a for a in data["annotations"] if a["image_id"] == image["id"]])
    data["annotations"] = [{**a, "id": number} for number, a in enumerate(annotations, start=1)]
    (folder / "train.json").write_text(json.dumps(data))
    return folder


def boxed(annotation, x, y, width, height):
    """The annotation with a rectangle as its mask."""
    pixels = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    pixels[y : y + height, x : x + width] = True
    return {**annotation, "bbox": [x, y, width, height], "area": width * height, "segmentation": rle(pixels)}


# The network --------------------------------------------------------------------------------------


@pytest.mark.parametrize("norm", ["batch", "group"])
def test_first_losses_from_scratch_are_of_order_1(coco, norm):
    torch.manual_seed(0)
    model = build_model(replace(SMALL, norm=norm, channels=128), classes=2)
    losses = model(*batch_of(coco))
    assert len(losses) == 5 and all(torch.isfinite(loss) for loss in losses.values())
    assert 0.5 < sum(losses.values()) < 20


def test_the_papers_network_takes_a_step(coco):
    config = preset("paper")
    assert (config.model.backbone, config.model.size_px, config.head_epochs, config.epochs) == (
        "resnet101", 512, 20, 40,
    )  # fmt: skip
    torch.manual_seed(0)
    model = build_model(with_norm(replace(config.model, size_px=128, rois=64), "scratch"), classes=2)
    assert sum(p.numel() for p in model.parameters()) == pytest.approx(62.9e6, rel=0.01)
    losses = model(*batch_of(coco, 128))
    sum(losses.values()).backward()
    assert all(0 <= loss < 20 for loss in losses.values())
    gradients = [p.grad for p in model.parameters() if p.grad is not None]
    assert gradients and all(torch.isfinite(gradient).all() for gradient in gradients)


def test_heads_leave_only_the_resnet_frozen():
    model = build_model(SMALL, classes=2)
    train_body(model, False)
    frozen = {name for name, p in model.named_parameters() if not p.requires_grad}
    assert frozen == {n for n, _ in model.named_parameters() if n.startswith("backbone.body.")}
    assert any(name.startswith("backbone.fpn.") for name, p in model.named_parameters() if p.requires_grad)
    train_body(model, True)
    assert all(p.requires_grad for p in model.parameters())


def test_norm_follows_the_weights():
    auto = replace(SMALL, norm="auto")
    assert with_norm(auto, "scratch").norm == "batch" and with_norm(auto, "resnet.pth").norm == "frozen"
    assert with_norm(SMALL, "resnet.pth").norm == "batch"


def test_resnet_weights_from_a_file(tmp_path):
    trained = resnet18(weights=None)
    torch.save(trained.state_dict(), tmp_path / "resnet.pth")
    config = with_norm(replace(SMALL, norm="auto"), "resnet.pth")
    model = build_model(config, classes=2)
    said = load_weights(model, config, str(tmp_path / "resnet.pth"))
    assert torch.equal(model.backbone.body.layer4[1].conv2.weight, trained.layer4[1].conv2.weight)
    assert "0 stay random" in said
    other = replace(config, backbone="resnet50")
    with pytest.raises(DataError, match="does not hold a resnet50"):
        load_weights(build_model(other, classes=2), other, str(tmp_path / "resnet.pth"))


def test_torchvisions_mask_rcnn_fits_all_but_its_classes(tmp_path):
    published = maskrcnn_resnet50_fpn(weights=None, weights_backbone=None, num_classes=91)
    torch.save(published.state_dict(), tmp_path / "coco.pth")
    config = ModelConfig(backbone="resnet50", size_px=64, norm="frozen")
    model = build_model(config, classes=2)
    said = load_weights(model, config, str(tmp_path / "coco.pth"))
    # Weight and bias of the class scores, the box offsets and the masks depend on the classes.
    assert " 6 stay random" in said
    same = model.roi_heads.mask_head[3][0].weight, published.roi_heads.mask_head[3][0].weight
    assert torch.equal(*same)


def test_broken_weights_are_refused(tmp_path):
    (tmp_path / "broken.pth").write_bytes(b"no weights")
    model = build_model(SMALL, classes=2)
    with pytest.raises(DataError, match="broken.pth"):
        load_weights(model, SMALL, str(tmp_path / "broken.pth"))
    with pytest.raises(DataError, match="does not exist"):
        load_weights(model, SMALL, str(tmp_path / "absent.pth"))


def test_settings_that_are_none(tmp_path):
    (tmp_path / "typo.yaml").write_text("settings: {epoch: 3}")
    with pytest.raises(DataError, match="epoch"):
        load_settings(tmp_path / "typo.yaml")
    with pytest.raises(DataError, match="does not exist"):
        load_settings(tmp_path / "absent.yaml")


@pytest.mark.parametrize("wrong", [{"size_px": 100}, {"rois": 0}])
def test_configs_that_cannot_be_built(wrong):
    with pytest.raises(DataError, match="model"):
        replace(SMALL, **wrong)


# Crops --------------------------------------------------------------------------------------------


def test_crops_repeat_and_change_with_the_epoch(coco):
    crops, again = (SquareCrops(coco / "train.json", 64, Augmentation(), seed=3) for _ in range(2))
    assert torch.equal(crops[4][0], again[4][0]) and torch.equal(crops[4][1]["masks"], again[4][1]["masks"])
    again.epoch = 1
    assert not torch.equal(crops[4][0], again[4][0])


def test_squares_stay_inside_the_image_without_shift():
    rng = np.random.default_rng(0)
    still = Augmentation(scale=0.0, shift=0.0, rotation_deg=0.0)
    lefts = []
    for _ in range(50):
        affine = random_square(160, 120, still, rng, size_px=60)
        np.testing.assert_allclose(affine[:, :2], np.eye(2) / 2)
        left, top = -2 * affine[:, 2] - 0.5  # where the crop begins, in pixels from the image's edge
        assert top == pytest.approx(0, abs=1e-9)
        lefts.append(left)
    assert -1e-9 <= min(lefts) < 5 and 35 < max(lefts) <= 40 + 1e-9


def test_slivers_are_not_trained_on(coco):
    crops = SquareCrops(coco / "train.json", 64, Augmentation(shift=0.5), seed=0)
    for crops.epoch in range(20):
        for row in range(len(crops)):
            boxes = crops[row][1]["boxes"]
            assert ((boxes[:, 2:] - boxes[:, :2]) >= SMALLEST_PX).all()


# Training -----------------------------------------------------------------------------------------


def test_resumed_run_has_the_same_losses(coco, tmp_path):
    straight = train(QUICK, coco, tmp_path / "straight")
    paused = train(QUICK, coco, tmp_path / "paused", until=1)
    assert paused.epochs == 1 and straight.epochs == 2
    resumed = train(QUICK, coco, tmp_path / "paused")
    assert resumed.epochs == 2
    assert losses_of(tmp_path / "straight") == losses_of(tmp_path / "paused")
    assert len(losses_of(tmp_path / "straight")) == 6
    states = [torch.load(done.checkpoint, weights_only=True)["state_dict"] for done in (straight, resumed)]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])
    segmenter = load_segmenter(resumed.checkpoint)
    assert segmenter.names == ("background", "box", "can") and segmenter.config == SMALL
    with pytest.raises(DataError, match="another rate"):
        train(replace(QUICK, rate=0.1), coco, tmp_path / "paused")


def test_learning_rate_rises_stays_and_falls():
    settings = replace(QUICK, epochs=10, rate=1.0, warmup_steps=5, cooldown=0.2)
    rates = [learning_rate(settings, step, 10) for step in range(100)]
    np.testing.assert_allclose(rates[:5], [0.2, 0.4, 0.6, 0.8, 1.0])
    np.testing.assert_allclose(rates[5:81], 1.0)
    np.testing.assert_allclose(rates[80:], np.linspace(1, 0.05, 20))


def test_a_loss_that_is_not_finite_names_the_batch(coco, tmp_path):
    with pytest.raises(DataError, match=r"step \d+: loss_.* = (nan|inf) on images/.*png, images/.*png"):
        train(replace(QUICK, rate=1e9, warmup_steps=0, clip=0.0, head_epochs=0), coco, tmp_path)


def test_a_class_absent_from_training(coco, tmp_path):
    data = rewritten(coco, tmp_path, lambda image, found: [a for a in found if a["category_id"] == 1])
    done = train(replace(QUICK, epochs=1), data, tmp_path / "run")
    segmenter = load_segmenter(done.checkpoint)
    image, _ = InstanceDataset(coco / "train.json")[0]
    assert segmenter.names == ("background", "box", "can")
    assert segmenter.model([image])[0]["masks"].shape[1:] == (1, 120, 160)


def test_images_without_objects_teach_the_background(coco, tmp_path):
    data = rewritten(coco, tmp_path, lambda image, annotations: [])
    images, targets = batch_of(data)
    assert [len(target["boxes"]) for target in targets] == [0, 0]
    losses = build_model(replace(SMALL, norm="group"), classes=2)(images, targets)
    assert losses["loss_classifier"] > 0 and losses["loss_objectness"] > 0
    assert losses["loss_mask"] == losses["loss_box_reg"] == losses["loss_rpn_box_reg"] == 0
    train(replace(QUICK, epochs=1), data, tmp_path / "run")
    assert all(np.isfinite(float(loss)) for _, loss, *_ in losses_of(tmp_path / "run"))


@pytest.mark.parametrize("size", [(1, 20), (20, 1)])
def test_slivers_of_an_object_are_left_out(coco, tmp_path, size):
    """torchvision refuses a whole batch for one box without width or height."""
    data = rewritten(coco, tmp_path, lambda image, found: [*found, *(boxed(a, 70, 50, *size) for a in found)])
    upright = Augmentation(shift=0.0, rotation_deg=0.0)
    crops = [SquareCrops(folder / "train.json", 64, upright, seed=0) for folder in (data, coco)]
    assert [len(each.images[2][1]["labels"]) for each in crops] == [4, 2]
    assert [each[2][1]["labels"].tolist() for each in crops] == [[1, 2], [1, 2]]


@pytest.mark.parametrize("box", [[70, 50, 0, 20], [0, 0, 0, 0]])
def test_degenerate_boxes_are_refused_before_training(coco, tmp_path, box):
    data = rewritten(
        coco, tmp_path, lambda image, found: [{**boxed(a, 0, 0, 0, 0), "bbox": box} for a in found]
    )
    with pytest.raises(DataError, match="train.json: annotation 1: .*export the dataset again"):
        train(QUICK, data, tmp_path / "run")


def test_more_than_100_instances(coco, tmp_path):
    """150 cubes in an image: all are trained on, and so many can be found."""
    data = rewritten(
        coco,
        tmp_path,
        lambda image, found: [
            boxed(found[0], 10 * (n % 15) + 2, 11 * (n // 15) + 4, 7, 8) for n in range(150 if found else 0)
        ],
    )
    dataset = InstanceDataset(data / "train.json")
    assert dataset[1][1]["masks"].shape == (150, CAMERA.height, CAMERA.width)
    images, targets = batch_of(data, 96)
    assert all(len(target["boxes"]) > 100 for target in targets)
    many = replace(SMALL, size_px=96, norm="group", detections=150, proposals=2000)
    model = build_model(many, classes=2)
    assert all(torch.isfinite(loss) for loss in model(images, targets).values())
    model.roi_heads.score_thresh, model.roi_heads.nms_thresh, model.rpn.nms_thresh = 0.0, 1.0, 1.0
    logits = model.roi_heads.mask_predictor.mask_fcn_logits
    for layer in (model.rpn.head.bbox_pred, model.roi_heads.box_predictor.bbox_pred, logits):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    torch.nn.init.ones_(logits.bias)  # whatever it was drawn as, its boxes are the anchors and its masks full
    found = predict(Segmenter(model.eval(), many, tuple(dataset.names)), dataset[1][0], 1)
    assert len(found) > 100


def test_nothing_to_train_on(coco, tmp_path):
    data = json.loads((coco / "train.json").read_text())
    (tmp_path / "train.json").write_text(json.dumps({**data, "images": [], "annotations": []}))
    with pytest.raises(DataError, match="no images"):
        train(QUICK, tmp_path, tmp_path / "run")
    assert not (tmp_path / "run" / CHECKPOINT).exists()
