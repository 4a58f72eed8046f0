"""Mask R-CNN: the network, its training and what it refuses."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import torch
from labelled_scenes import CAMERA, exported, rle
from torchvision.models import resnet18
from torchvision.models.detection import maskrcnn_resnet50_fpn

from rpl_data.torch.epochs import SeededRows
from rpl_data.torch.instances import InstanceDataset
from rpl_data.torch.transforms import Augmentation
from rpl_data.types import DataError
from training.evaluate_masks import evaluate_masks
from training.masks.crops import SMALLEST_PX, SquareCrops, random_square
from training.masks.mask_rcnn import build_model, train_body, with_norm
from training.masks.module import class_ious
from training.masks.results import predict, predict_split
from training.masks.scores import score_split
from training.masks.settings import OLD_NAMES as NEW_BY_OLD
from training.masks.settings import MaskSettings, load_settings
from training.masks.weights import Segmenter, load_segmenter, load_weights
from training.predict_masks import predict_masks
from training.reproduce.segmentation.experiment import given
from training.runs.options import Learning, Machine, MaskNetwork
from training.runs.program import main
from training.runs.schedule import learning_rate
from training.train_masks import train_masks

ROOT = Path(__file__).parents[2]
SMALL = MaskNetwork(
    backbone="resnet18", size_px=64, channels=32, hidden=64, proposals=50, rois=16, norm="batch"
)
QUICK = MaskSettings(
    network=SMALL,
    learning=Learning(epochs=2, batch=2, optimizer="adamw", rate=1e-3, warmup_steps=2, clip=5.0),
    machine=Machine(accelerator="cpu"),
    weights="scratch",
    head_epochs=1,
)
ONCE = replace(QUICK, learning=replace(QUICK.learning, epochs=1))


@pytest.fixture(scope="module")
def coco(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("masks"))


def preset(name):
    return load_settings(ROOT / f"training/configs/masks_{name}.yaml")


def train(settings, coco, out, **more):
    return train_masks(coco, out, **given(settings), **more)


def losses_of(out):
    rows = []
    for file in sorted(out.glob("logs*/metrics.csv")):
        with file.open() as lines:
            rows += [(row["step"], row["train_loss"], row["rate"]) for row in csv.DictReader(lines)]
    return [row for row in rows if row[1]]


def batch_of(coco, size_px=64):
    torch.manual_seed(0)
    crops = SquareCrops(coco / "train.json", size_px, Augmentation(shift=0.0))
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
    assert (config.network.backbone, config.network.size_px, config.head_epochs, config.learning.epochs) == (
        "resnet101", 512, 20, 40,
    )  # fmt: skip
    torch.manual_seed(0)
    model = build_model(with_norm(replace(config.network, size_px=128, rois=64), "scratch"), classes=2)
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
    assert "100 tensors taken, 42 stay random" in said  # pyramid and heads
    other = replace(config, backbone="resnet50")
    with pytest.raises(DataError, match="does not hold the network resnet50"):
        load_weights(build_model(other, classes=2), other, str(tmp_path / "resnet.pth"))


def test_torchvisions_mask_rcnn_fits_all_but_its_classes(tmp_path):
    published = maskrcnn_resnet50_fpn(weights=None, weights_backbone=None, num_classes=91)
    torch.save(published.state_dict(), tmp_path / "coco.pth")
    config = MaskNetwork(backbone="resnet50", size_px=64, norm="frozen")
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
    (tmp_path / "typo.yaml").write_text("learning: {epoch: 3}")
    with pytest.raises(DataError, match="epoch"):
        load_settings(tmp_path / "typo.yaml")
    with pytest.raises(DataError, match="does not exist"):
        load_settings(tmp_path / "absent.yaml")
    with pytest.raises(DataError, match="head_epochs"):
        replace(QUICK, head_epochs=3)


OLD_NAMES = """
settings:
  model: {backbone: resnet18, size_px: 64, channels: 32}
  augmentation: {scale: 0.2}
  weights: scratch
  epochs: 3
  head_epochs: 1
  workers: 0
"""


def test_old_names_are_understood_with_a_hint(coco, tmp_path, capsys):
    (tmp_path / "old.yaml").write_text(OLD_NAMES)
    settings = load_settings(tmp_path / "old.yaml")
    said = capsys.readouterr().err
    assert "settings.model is now network" in said and "settings.epochs is now learning.epochs" in said
    assert settings.network == MaskNetwork(backbone="resnet18", size_px=64, channels=32)
    assert (settings.learning.epochs, settings.learning.optimizer, settings.learning.batch) == (3, "sgd", 2)
    assert (settings.weights, settings.head_epochs, settings.machine.workers) == ("scratch", 1, 0)
    assert (settings.augment.scale, settings.augment.rotation_deg) == (0.2, 10.0)
    preset("cpu")
    assert capsys.readouterr().err == ""  # ours have the new names
    command = ["--config", str(tmp_path / "old.yaml"), str(coco), "--out", str(tmp_path / "run")]
    smaller = ["--settings.model.hidden=32", "--settings.epochs", "1", "--network.norm=group", "--until=1"]
    assert main(train_masks, [*command, *smaller], old_names=NEW_BY_OLD, presets=True) == 0
    said = capsys.readouterr().err
    assert "--settings.epochs is now --learning.epochs" in said and "--settings.model.hidden" in said
    network = load_segmenter(tmp_path / "run" / "last.ckpt").network
    assert (network.size_px, network.hidden, network.norm) == (64, 32, "group")


@pytest.mark.parametrize("wrong", [{"size_px": 100}, {"rois": 0}])
def test_configs_that_cannot_be_built(wrong):
    with pytest.raises(DataError, match="network"):
        replace(SMALL, **wrong)


# Crops --------------------------------------------------------------------------------------------


def test_crops_repeat_and_change_with_the_epoch(coco):
    crops, again = (
        SeededRows(SquareCrops(coco / "train.json", 64, Augmentation()), seed=3) for _ in range(2)
    )
    before = torch.random.get_rng_state()
    first, second = crops[0, 4], again[0, 4]
    assert torch.equal(first[0], second[0]) and torch.equal(first[1]["masks"], second[1]["masks"])
    assert not torch.equal(first[0], again[1, 4][0])
    assert torch.equal(before, torch.random.get_rng_state())


def test_a_turn_that_only_one_object_can_decide_is_refused_at_once(coco):
    with pytest.raises(DataError, match="rotation_deg is auto, which is for one object's crops"):
        SquareCrops(coco / "train.json", 64, Augmentation(rotation_deg="auto"))


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
    crops = SeededRows(SquareCrops(coco / "train.json", 64, Augmentation(shift=0.5)), seed=0)
    for epoch in range(20):
        for row in range(len(crops)):
            boxes = crops[epoch, row][1]["boxes"]
            assert ((boxes[:, 2:] - boxes[:, :2]) >= SMALLEST_PX).all()


# Training -----------------------------------------------------------------------------------------


def test_checkpoint_rebuilds_the_network(coco, tmp_path):
    checkpoint = train(ONCE, coco, tmp_path)
    segmenter = load_segmenter(checkpoint)
    assert segmenter.names == ("background", "box", "can") and segmenter.network == SMALL
    state = torch.load(checkpoint, weights_only=True)["state_dict"]
    assert all(
        torch.equal(value, state[f"model.{key}"]) for key, value in segmenter.model.state_dict().items()
    )
    with pytest.raises(DataError, match="resume with the options"):
        train(replace(ONCE, network=replace(SMALL, hidden=32)), coco, tmp_path, resume=True)


def test_what_is_found_in_a_crowd_is_not_judged():
    left, right = torch.zeros(2, 4, 8, dtype=torch.uint8)
    left[:, :4], right[:, 4:] = 1, 1
    target = {"labels": torch.tensor([1, 1]), "masks": torch.stack([left, right])}
    everywhere = {"scores": torch.ones(1), "labels": torch.ones(1), "masks": torch.ones(1, 1, 4, 8)}
    assert class_ious(everywhere, target | {"iscrowd": torch.tensor([0, 1])}) == [1.0]
    assert class_ious(everywhere, target | {"iscrowd": torch.tensor([1, 1])}) == []


def test_validated_iou_is_that_of_the_scores(coco, monkeypatch):
    """Random weights that find something everywhere, judged by the module and by the evaluation."""
    import training.masks.module as module

    torch.manual_seed(0)
    network = replace(SMALL, norm="group", detections=5)
    segmenter = Segmenter(build_model(network, classes=2).eval(), network, ("background", "box", "can"))
    segmenter.model.roi_heads.score_thresh = 0.0
    monkeypatch.setattr(module, "SCORE_THRESHOLD", 0.0)
    dataset, path, ious = InstanceDataset(coco / "train.json"), coco / "train.json", []
    with torch.no_grad():
        for image, target in (dataset[row] for row in range(len(dataset))):
            ious += class_ious(segmenter.model([image])[0], target)
    scores = score_split(path, predict_split(segmenter, path)[0], threshold=0.0)
    weights = [row.images for row in scores.classes]
    expected = np.average([row.mean_iou for row in scores.classes], weights=weights)
    assert len(ious) == sum(weights) == 10 and np.mean(ious) == pytest.approx(expected)
    assert 0.001 < expected < 0.9


def test_a_broken_image_is_left_out_and_counted(coco, tmp_path, capsys):
    """In training, validation, evaluation and prediction."""
    place = tmp_path / "coco"
    shutil.copytree(coco, place)
    bad = place / json.loads((place / "train.json").read_text())["images"][3]["file_name"]
    bad.write_bytes(b"no image")
    shutil.copy(place / "train.json", place / "val.json")
    checkpoint = train(QUICK, place, tmp_path / "run")
    said = capsys.readouterr().out
    assert (
        f"left out 4 times: cannot read the image {bad}" in said
    )  # two epochs of training and of validation
    assert (tmp_path / "run" / "best.ckpt").exists()
    evaluate_masks(place, checkpoint, "val", tmp_path / "scores")
    assert f"left out 1 time: cannot read the image {bad}" in capsys.readouterr().out
    assert json.loads((tmp_path / "scores" / "val_scores.json").read_text())["images"] == 5
    predict_masks(place / "images" / "desk", checkpoint, tmp_path / "found")
    said = capsys.readouterr().out
    assert "5 images" in said and f"left out 1 time: cannot read the image {bad}" in said
    with pytest.raises(DataError, match="no holdout split.*train, val"):
        evaluate_masks(place, checkpoint, "holdout")


def test_half_precision_takes_a_step(coco, tmp_path):
    train(replace(ONCE, machine=Machine("cpu", precision="bf16-mixed")), coco, tmp_path)
    assert all(np.isfinite(float(loss)) for _, loss, *_ in losses_of(tmp_path))


def test_learning_rate_rises_stays_and_falls():
    learning = replace(QUICK.learning, epochs=10, rate=1.0, warmup_steps=5, cooldown=0.2)
    rates = [learning_rate(learning, step, 10) for step in range(100)]
    np.testing.assert_allclose(rates[:5], [0.2, 0.4, 0.6, 0.8, 1.0])
    np.testing.assert_allclose(rates[5:81], 1.0)
    np.testing.assert_allclose(rates[80:], np.linspace(1, 0.05, 20))


def test_a_loss_that_is_not_finite_names_the_batch(coco, tmp_path):
    wild = replace(QUICK.learning, rate=1e9, warmup_steps=0, clip=0.0)
    with pytest.raises(DataError, match=r"epoch \d, batch \d, images \d, \d .*: loss_\w+ is (nan|inf)"):
        train(replace(QUICK, learning=wild, head_epochs=0), coco, tmp_path)


def test_a_class_absent_from_training(coco, tmp_path):
    data = rewritten(coco, tmp_path, lambda image, found: [a for a in found if a["category_id"] == 1])
    segmenter = load_segmenter(train(ONCE, data, tmp_path / "run"))
    image, _ = InstanceDataset(coco / "train.json")[0]
    assert segmenter.names == ("background", "box", "can")
    assert segmenter.model([image])[0]["masks"].shape[1:] == (1, 120, 160)


def test_images_without_objects_teach_the_background(coco, tmp_path):
    row = count()  # the batch is of rows 2 and 3; if no image showed an object, there were nothing to learn
    data = rewritten(coco, tmp_path, lambda image, shown: [] if next(row) in (2, 3) else shown)
    images, targets = batch_of(data)
    assert [len(target["boxes"]) for target in targets] == [0, 0]
    losses = build_model(replace(SMALL, norm="group"), classes=2)(images, targets)
    assert losses["loss_classifier"] > 0 and losses["loss_objectness"] > 0
    assert losses["loss_mask"] == losses["loss_box_reg"] == losses["loss_rpn_box_reg"] == 0
    train(ONCE, data, tmp_path / "run")
    assert all(np.isfinite(float(loss)) for _, loss, *_ in losses_of(tmp_path / "run"))


@pytest.mark.parametrize("size", [(1, 20), (20, 1)])
def test_slivers_of_an_object_are_left_out(coco, tmp_path, size):
    """torchvision refuses a whole batch for one box without width or height."""
    data = rewritten(coco, tmp_path, lambda image, found: [*found, *(boxed(a, 70, 50, *size) for a in found)])
    upright = Augmentation(shift=0.0, rotation_deg=0.0)
    crops = [SquareCrops(folder / "train.json", 64, upright) for folder in (data, coco)]
    whole = [InstanceDataset(folder / "train.json") for folder in (data, coco)]
    assert [len(each[2][1]["labels"]) for each in whole] == [4, 2]
    for each in crops:
        torch.manual_seed(0)  # the same crop, which shows both objects
        assert each[2][1]["labels"].tolist() == [1, 2]


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
    assert not (tmp_path / "run" / "last.ckpt").exists()
