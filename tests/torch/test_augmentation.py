"""Augmentation: colours, backgrounds, occluders, and how far crops turn."""

import json

import cv2
import numpy as np
import pytest
import torch
from labelled_scenes import BOX, exported, two_boxes

from rpl_data.export import export_coco
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import read_coco, write_coco
from rpl_data.geometry import from_rotvec
from rpl_data.torch.augmentation import Augmentation
from rpl_data.torch.colours import jittered
from rpl_data.torch.cutouts import Piece, Pieces
from rpl_data.torch.detection import DetectionDataset
from rpl_data.torch.epochs import SeededRows
from rpl_data.torch.keypoints import KeypointDataset
from rpl_data.torch.pasting import Pasting, hide, pasted
from rpl_data.torch.transforms import moved, warped
from rpl_data.torch.turns import turn_by_places, up_in_object
from rpl_data.torch.warps import RandomAffine
from rpl_data.types import DataError

STILL = {"scale": 0.0, "shift": 0.0, "rotation_deg": 0.0, "gain": 0.0, "offset": 0.0}
GREY = np.full((40, 60, 3), 128, dtype=np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    coco = exported(tmp_path_factory.mktemp("augmentation"))
    data = json.loads((coco / "train.json").read_text())
    for annotation in data["annotations"]:
        annotation["visib_fract"] = 1.0  # so that the can is whole enough to be cut out
    (coco / "train.json").write_text(json.dumps(data))
    return coco


# Colours ------------------------------------------------------------------------------------------


def test_noise_has_at_most_its_standard_deviation():
    rng = np.random.default_rng(0)
    found = [jittered(GREY, Augmentation(**STILL, noise=0.04), rng).std() / 255 for _ in range(50)]
    assert max(found) < 0.042 and np.ptp(found) > 0.03


def test_blur_keeps_the_mean_and_takes_the_detail():
    rng = np.random.default_rng(0)
    image = np.zeros((41, 41, 3), dtype=np.uint8)
    image[::2] = 200
    found = [jittered(image, Augmentation(**STILL, blur_px=2.0), rng) for _ in range(20)]
    assert all(abs(one[10:30].mean() - 100) < 2 for one in found)
    assert min(np.ptp(one[10:30]) for one in found) < 10 < 150 < max(np.ptp(one[10:30]) for one in found)
    np.testing.assert_array_equal(jittered(GREY, Augmentation(**STILL, blur_px=2.0), rng), GREY)


def test_light_shades_along_a_direction_and_bends_the_brightness():
    rng = np.random.default_rng(0)
    found = [jittered(GREY, Augmentation(**STILL, light=0.5), rng)[..., 0].astype(float) for _ in range(100)]
    bend = np.array([np.median(one) for one in found]) / 255
    # The exponents 1 / 1.5 and 1.5 at a brightness of a half.
    assert bend.min() > 0.5**1.5 - 0.02 and bend.max() < 0.5 ** (1 / 1.5) + 0.02 and np.ptp(bend) > 0.2
    shade = [one.max() / one.min() for one in found]
    assert 1.2 < max(shade) < (1 + 0.5 * 0.71) / (1 - 0.5 * 0.71)
    for one in found:  # a plane, but for rounding: the second differences vanish
        assert np.abs(np.diff(one, 2, axis=0)).max() <= 2 and np.abs(np.diff(one, 2, axis=1)).max() <= 2


# Backgrounds and occluders ------------------------------------------------------------------------


def mask_of(data, row):
    """Where the object is seen in the crop."""
    sample = data[row]
    mask = data._rows.mask(row) * np.uint8(255)
    return warped(mask, sample["crop_from_image"].numpy(), size=(data.input_px, data.input_px))


def test_only_what_is_not_the_object_is_replaced(folder, tmp_path):
    cv2.imwrite(str(tmp_path / "green.png"), np.full((70, 90, 3), (0, 200, 0), dtype=np.uint8))
    wish = Augmentation(**STILL, background=1.0, backgrounds=str(tmp_path))
    plain = KeypointDataset(folder, split="train", object="box", input_px=64)
    data = KeypointDataset(folder, split="train", object="box", input_px=64, augment=wish)
    for row in range(len(data)):
        mask = mask_of(plain, row)
        inner, outer = cv2.erode(mask, np.ones((9, 9))) == 255, cv2.dilate(mask, np.ones((9, 9))) == 0
        assert inner.any() and outer.any()
        before, after = plain[row], data[row]
        assert (after["image"] - before["image"]).abs()[:, torch.from_numpy(inner)].max() < 2 / 255
        green = torch.tensor([0, 200 / 255, 0])[:, None]
        assert (after["image"][:, torch.from_numpy(outer)] - green).abs().max() < 2 / 255
        assert torch.equal(before["heatmaps"], after["heatmaps"])


def test_backgrounds_show_other_frames_of_the_split_beside_the_object(folder):
    data = KeypointDataset(
        folder, split="train", object="box", input_px=64, augment=Augmentation(**STILL, background=0.5)
    )
    files = dict(zip(data._rows.files.tolist(), data._rows.square_boxes, strict=True))
    pieces = data._pasting.backgrounds._pieces
    assert {piece.file for piece in pieces} <= set(files)
    for piece in pieces:
        (cx, cy, side), strip = files[piece.file], piece.rectangle
        left, right, top, bottom = cx - side / 2, cx + side / 2, cy - side / 2, cy + side / 2
        beside = strip.right <= right and strip.right - 1 <= left or strip.left >= right - 1
        assert beside or strip.bottom - 1 <= top or strip.top >= bottom - 1
    plain = KeypointDataset(folder, split="train", object="box", input_px=64)
    torch.manual_seed(0)
    changed = [not torch.equal(data[1]["image"], plain[1]["image"]) for _ in range(40)]
    assert 8 < sum(changed) < 32  # half of the crops


def test_seeds_repeat_also_with_what_is_pasted(folder):
    wish = Augmentation(background=0.7, occluders=0.7, light=0.3, noise=0.05, blur_px=1.0)
    data = [KeypointDataset(folder, split="train", object="box", augment=wish) for _ in range(2)]
    order = [3, 1, 2, 0, 4]  # another order decodes other pieces first
    first = [SeededRows(data[0], 7)[2, row]["image"] for row in sorted(order)]
    second = {row: SeededRows(data[1], 7)[2, row]["image"] for row in order}
    assert all(torch.equal(image, second[row]) for row, image in enumerate(first))


def test_occluders_hide_at_most_half_and_their_keypoints(folder):
    wish = Augmentation(**STILL, occluders=1.0)
    data = KeypointDataset(folder, split="train", object="box", augment=wish)
    assert {piece.mask is not None for piece in data._pasting.occluders._pieces} == {True}
    plain = KeypointDataset(folder, split="train", object="box")
    mask, size = mask_of(plain, 1), (64, 64)
    red = Pieces([Piece("red")], 64)
    red._decoded[0] = np.full((*size, 3), (255, 0, 0), dtype=np.uint8), np.full(size, 255, dtype=np.uint8)
    rng, hidden = np.random.default_rng(0), []
    for _ in range(30):
        crop = np.zeros((256, 256, 3), dtype=np.uint8)
        crop, covered = pasted(crop, mask, Pasting(None, red), wish, rng)
        if covered is not None:
            hidden.append((covered & (mask > 0)).sum() / (mask > 0).sum())
            assert (crop[covered][:, 0] > 100).mean() > 0.95 and crop[~covered].mean() < 3
    assert len(hidden) > 10 and min(hidden) > 0 and max(hidden) <= 0.5 + 1e-9
    keypoints = np.array([[10.0, 10, 2], [20, 20, 2], [30, 30, 1], [0, 0, 0], [999, 10, 2]])
    covered = np.zeros((64, 64), dtype=bool)
    covered[:, :15] = True
    assert hide(keypoints, keypoints[:, :2], covered)[:, 2].tolist() == [1, 2, 1, 0, 2]


def test_what_cannot_be_pasted_is_said(folder, tmp_path):
    alone = exported(tmp_path / "alone", models=(BOX,))
    with pytest.raises(DataError, match="shows no other object"):
        KeypointDataset(alone, split="train", augment=Augmentation(occluders=0.5))
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="has no pictures"):
        wish = Augmentation(background=0.5, backgrounds=str(tmp_path / "empty"))
        KeypointDataset(folder, split="train", object="box", augment=wish)
    for wish in (
        Augmentation(background=0.5, rotation_deg=0.0),
        Augmentation(occluders=1.0, rotation_deg=0.0),
    ):
        with pytest.raises(DataError, match="for the crops of"):
            RandomAffine(wish)
        with pytest.raises(DataError, match="for the crops of"):
            DetectionDataset(folder, split="train", augment=wish)
    with pytest.raises(DataError, match="share of crops"):
        Augmentation(background=1.5)
    with pytest.raises(DataError, match="a folder that nothing uses"):
        Augmentation(backgrounds="pictures")


# Turns --------------------------------------------------------------------------------------------


def orbit(side, rng, *, tilt_deg=40.0, arc_deg=150.0):
    """Poses of an object that lies on a side, seen by a camera that is carried around it, rolled a little."""
    poses = []
    for azimuth in np.deg2rad(rng.uniform(0, 360) + np.linspace(0, arc_deg, 30)):
        tilt = np.deg2rad(tilt_deg) + rng.normal(0, 0.05)
        forward = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), -np.sin(tilt)])
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        level = np.eye(4)
        level[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        roll = from_rotvec(np.array([0, 0, rng.normal(0, np.deg2rad(6))]), np.zeros(3))
        poses.append(roll @ level @ side)
    return np.array(poses)


def lying(rotvec):
    return from_rotvec(np.array(rotvec), np.zeros(3))


def test_the_side_that_is_up_is_found():
    rng = np.random.default_rng(0)
    for rotvec in ([0, 0, 0.7], [1.2, 0, 0], [0, 2.0, 1.0]):
        side = lying(rotvec)
        for arc_deg, within_deg in ((150.0, 4.0), (40.0, 12.0)):
            up = up_in_object(orbit(side, rng, arc_deg=arc_deg))
            assert np.rad2deg(np.arccos(up @ side[2, :3])) < within_deg


def test_crops_turn_fully_where_scenes_show_other_sides_up():
    rng = np.random.default_rng(1)
    scenes = np.repeat(["a", "b", "c"], 30)
    standing = [orbit(lying([0, 0, yaw]), rng) for yaw in (0.0, 2.0, 4.0)]
    assert turn_by_places(scenes, np.concatenate(standing)) == 30.0
    fallen = [*standing[:2], orbit(lying([np.pi / 2, 0, 0]), rng)]
    assert turn_by_places(scenes, np.concatenate(fallen)) == 180.0
    assert turn_by_places(scenes[:30], standing[0]) == 30.0  # one scene says nothing


def test_two_instances_of_a_scene_may_lie_on_different_sides(tmp_path):
    export_coco(tmp_path / "coco", [two_boxes(tmp_path)], [BOX], split=SplitRule(val_fraction=0.0))
    data, over = read_coco(tmp_path / "coco" / "train.json"), lying([np.pi / 2, 0, 0])
    for one in data["annotations"]:
        if one.get("instance") == "2":
            one["camera_from_object"] = (
                (np.reshape(one["camera_from_object"], (4, 4)) @ over).ravel().tolist()
            )
    write_coco(tmp_path / "coco" / "train.json", data)
    found = KeypointDataset(tmp_path / "coco", split="train", augment=Augmentation(rotation_deg="auto"))
    assert found.augment.rotation_deg == 180.0


def test_auto_is_decided_by_the_dataset_and_refused_elsewhere(folder):
    data = KeypointDataset(folder, split="train", object="box", augment=Augmentation(rotation_deg="auto"))
    assert data.augment.rotation_deg == 30.0
    with pytest.raises(DataError, match="rotation_deg is auto"):
        RandomAffine(Augmentation(rotation_deg="auto"))


def test_keypoints_stay_on_their_pixels_in_full_turns(folder):
    torch.manual_seed(0)
    data = KeypointDataset(
        folder, split="train", object="box", augment=Augmentation(**STILL | {"rotation_deg": 180.0})
    )
    crops = [data[2]["crop_from_image"].numpy() for _ in range(40)]
    turns = np.array([np.rad2deg(np.arctan2(one[1, 0], one[0, 0])) for one in crops])
    assert turns.min() < -120 and turns.max() > 120
    centre = data[2]["square_box"].numpy()[:2]
    np.testing.assert_allclose([moved(one, centre) for one in crops], 127.5, atol=1e-9)
