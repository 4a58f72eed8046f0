"""Transforms of whole images before crops are cut: by torchvision, albumentations and kornia."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from labelled_scenes import exported
from torchvision import tv_tensors
from torchvision.transforms import v2
from torchvision.transforms.v2 import functional

from rpl_data.torch import KeypointDataset, from_albumentations, from_kornia
from rpl_data.torch.epochs import SeededRows
from rpl_data.torch.instances import InstanceDataset
from rpl_data.torch.transforms import moved
from rpl_data.torch.views import _mirrored
from rpl_data.types import DataError

PAGE = (Path(__file__).parents[2] / "docs/training.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("transforms"))


@pytest.mark.parametrize("package", ["albumentations", "kornia", "torchdata"])
def test_examples_of_the_page_run(folder, package):
    pytest.importorskip(package, reason=f"{package} is not installed")
    mine = [block for block in BLOCKS if re.search(rf"^(from|import) {package}\b", block, re.M)]
    names = {}
    for block in [BLOCKS[0], mine[-1]]:
        exec(block.replace("my-workspace/export/coco", str(folder)).replace("cube", "box"), names)  # noqa: S102
    assert names["train"][0]["weights"].sum() > 0


def albumentations_affine():
    A = pytest.importorskip("albumentations", reason="albumentations is not installed")
    affine = A.Affine(rotate=(25, 25), scale=(1.2, 1.2), translate_px={"x": 4, "y": -3}, p=1.0)
    return from_albumentations(
        A.Compose([affine], keypoint_params=A.KeypointParams("xy", remove_invisible=False))
    )


def kornia_affine():
    K = pytest.importorskip("kornia.augmentation", reason="kornia is not installed")
    step = K.RandomAffine((25.0, 25.0), (0.05, 0.05), (1.2, 1.2), p=1.0)
    return from_kornia(K.AugmentationSequential(step, data_keys=["input", "mask", "keypoints"]))


def torchvision_affine():
    return v2.RandomAffine((25, 25), (0.05, 0.05), (1.2, 1.2), interpolation=v2.InterpolationMode.BILINEAR)


@pytest.mark.parametrize("make", [torchvision_affine, albumentations_affine, kornia_affine])
def test_keypoints_follow_the_pixels(folder, make):
    """Image and points of spots, moved by each library: the spots are at the points."""
    torch.manual_seed(0)
    _, target = InstanceDataset(folder, split="train")[5]
    spots = np.array([[80.0, 60.0], [95.0, 50.0], [60.0, 70.0], [70.0, 45.0]])
    v, u = np.mgrid[:120, :160]
    for index, spot in enumerate(spots):
        image = np.exp(-((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / 18).astype(np.float32)
        points = torch.full((2, 4, 2), 50.0)
        points[0, 0] = torch.from_numpy(spot + 0.5).float()
        before = target | {
            "points": tv_tensors.KeyPoints(points, canvas_size=(120, 160)),
            "visibility": torch.full((2, 4), 2),
        }
        torch.manual_seed(index)
        out, after = make()(tv_tensors.Image(torch.from_numpy(image).expand(3, -1, -1).clone()), before)
        weight = out[0].as_subclass(torch.Tensor).double().numpy()
        centre = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        there = after["points"].as_subclass(torch.Tensor)[0, 0].numpy() - 0.5
        assert np.abs(there - centre).max() < 0.05
        assert np.abs(there - spot).max() > 2


def shifted(image, target):
    """Everything 7 px to the right and 4 px up."""
    still = {key: value for key, value in target.items() if not isinstance(value, tv_tensors.TVTensor)}
    move = {"angle": 0.0, "translate": [7, -4], "scale": 1.0, "shear": [0.0, 0.0]}
    moved = {key: functional.affine(value, **move) for key, value in target.items() if key not in still}
    return functional.affine(image, **move), still | moved


def test_the_crop_follows_the_moved_object(folder):
    plain = KeypointDataset(folder, split="train", object="box", input_px=64)
    there = KeypointDataset(folder, split="train", object="box", input_px=64, transforms=shifted)
    for a, b in zip(plain, there, strict=True):
        known = a["visibility"] > 0
        step = torch.tensor([7.0, -4.0], dtype=torch.float64)
        torch.testing.assert_close(
            (b["keypoints_px"] - a["keypoints_px"])[known], step.expand(3, 2), atol=1e-4, rtol=0
        )
        torch.testing.assert_close(b["square_box"][:2] - a["square_box"][:2], step, atol=1e-3, rtol=0)
        torch.testing.assert_close(a["heatmaps"], b["heatmaps"], atol=1e-3, rtol=0)
        inside = b["image"] > 0  # what came from beyond the image is black
        assert (a["image"] - b["image"])[inside].abs().mean() < 0.01
        assert b["camera_matrix"].isnan().all() and b["camera_from_object"].isnan().all()
        on_crop = moved(b["crop_from_image"].numpy(), b["keypoints_px"].numpy())
        assert np.isfinite(on_crop[:3]).all()


def test_the_crop_of_one_keypoint_is_around_the_mask(folder, tmp_path):
    """Around a point there is no square."""
    data = json.loads((folder / "train.json").read_text())
    data["categories"][0] |= {"keypoints": ["a"], "skeleton": []}
    data["rpl"]["objects"][0]["points_object"] = data["rpl"]["objects"][0]["points_object"][:1]
    data["annotations"] = [one for one in data["annotations"] if one["category_id"] == 1]
    for one in data["annotations"]:
        one |= {"keypoints": one["keypoints"][:3], "num_keypoints": 1, "sigma_px": one["sigma_px"][:1]}
    (tmp_path / "train.json").write_text(json.dumps(data))
    (tmp_path / "images").symlink_to(folder / "images")
    sample = KeypointDataset(tmp_path, split="train", object="box", input_px=64, transforms=shifted)[0]
    x, y, width, height = data["annotations"][0]["bbox"]
    centre = [x + width / 2 - 0.5 + 7, y + height / 2 - 0.5 - 4]
    assert sample["square_box"].tolist() == pytest.approx([*centre, 1.5 * max(width, height)], abs=1e-3)


def test_colours_leave_the_camera_known(folder):
    darker = v2.Lambda(lambda image: image * 0.5, tv_tensors.Image)
    plain = KeypointDataset(folder, split="train", object="box")[0]
    dark = KeypointDataset(folder, split="train", object="box", transforms=darker)[0]
    torch.testing.assert_close(dark["image"], plain["image"] / 2, atol=2 / 255, rtol=0)
    for key in ("camera_matrix", "camera_from_object", "keypoints_px", "square_box", "heatmaps"):
        torch.testing.assert_close(dark[key], plain[key], atol=1e-4, rtol=0, equal_nan=True)


def test_transforms_work_with_a_cache_and_repeat_with_the_seed(folder):
    moves = v2.RandomAffine(30, scale=(0.8, 1.2))
    kinds = {"split": "train", "object": "box", "input_px": 64, "transforms": moves}
    plain = SeededRows(KeypointDataset(folder, **kinds), 3)
    cached = SeededRows(KeypointDataset(folder, **kinds, cache=True), 3)
    torch.testing.assert_close(plain[1, 2]["image"], cached[1, 2]["image"], atol=0, rtol=0)
    assert not torch.equal(plain[1, 2]["image"], plain[2, 2]["image"])


def test_an_object_that_leaves_the_image_is_given_unmoved(folder):
    def gone(image, target):
        return image * 0, target | {"visibility": torch.zeros_like(target["visibility"])}

    plain = KeypointDataset(folder, split="train", object="box")[0]
    sample = KeypointDataset(folder, split="train", object="box", transforms=gone)[0]
    assert torch.equal(plain["image"], sample["image"]) and torch.equal(plain["heatmaps"], sample["heatmaps"])


def test_plain_tensors_are_refused(folder):
    data = KeypointDataset(
        folder, split="train", object="box", transforms=lambda i, t: (i, t | {"points": t["points"] * 1.0})
    )
    with pytest.raises(DataError, match="plain tensor for points"):
        data[0]


WRONG = {
    "nothing": (lambda image, target: None, "must return two things.* got NoneType"),
    "no masks": (lambda i, t: (i, {k: t[k] for k in t if k != "masks"}), "with all its keys"),
    "a flip": (v2.RandomHorizontalFlip(1.0), "transforms mirror: .* leave flips out"),
    "bytes": (
        lambda image, target: ((image * 255).to(torch.uint8), target),
        "uint8, 3 x 120 x 160; expected",
    ),
    "one channel": (v2.Grayscale(1), r"float32, 1 x 120 x 160; expected float, 3 x"),
    "a normal distribution": (v2.Normalize([0.5] * 3, [0.25] * 3), "brightnesses from -.*: normalise"),
    "NaN": (lambda image, target: (image * torch.nan, target), "brightnesses from nan"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_would_be_cut_off_or_mirrored_in_silence_is_refused(folder, wrong):
    transforms, said = WRONG[wrong]
    with pytest.raises(DataError, match=said):
        KeypointDataset(folder, split="train", object="box", transforms=transforms)[0]
    if "return" in said:
        with pytest.raises(DataError, match=said):
            InstanceDataset(folder, transforms, split="train")[1]


def test_points_on_a_line_are_not_called_mirrored_nor_are_turns():
    points = np.array([[10.0, 10], [30, 10], [10, 40]])
    assert _mirrored(points, points * [-1, 1]) and not _mirrored(points, points @ [[0, 1], [-1, 0]])
    assert not _mirrored(points[:2], points[:2] * [-1, 1])
    assert not _mirrored(points * [1, 0.01], points * [-1, 0.01])
    for seed in range(20):  # near a line, a local warp of each point tells no side of it
        rng = np.random.default_rng(seed)
        thin = np.column_stack([np.arange(0, 160, 20.0), rng.normal(size=8)])
        assert not _mirrored(thin, thin + 4 * rng.normal(size=(8, 2)))


def test_points_that_became_no_numbers_leave_the_image_as_it_was(folder):
    def lost(image, target):
        points = tv_tensors.wrap(target["points"] * torch.nan, like=target["points"])
        return image, {**target, "points": points}

    plain, kept = (
        KeypointDataset(folder, split="train", object="box", transforms=one)[0] for one in (None, lost)
    )
    torch.testing.assert_close(kept["keypoints_px"], plain["keypoints_px"], equal_nan=True)
