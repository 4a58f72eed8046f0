"""Crops that are rendered while a network trains."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from cube_studio import CAMERA, COLORS, CORNERS, cube_studio
from torch.utils.data import DataLoader

from rpl_data.torch import Augmentation, KeypointDataset, PartlySynthetic, SyntheticKeypoints
from rpl_data.torch.partly_synthetic import partly_synthetic
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

PLAIN = Augmentation(rotation_deg=0.0, scale=0.0, shift=0.0, gain=0.0, offset=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synthetic")
    cube_studio(folder / "studio")
    return folder


def views(folder: Path, **options: object) -> SyntheticKeypoints:
    return SyntheticKeypoints(folder, object="cube", input_px=64, heatmap_px=16, length=5, **options)


def test_samples_are_those_of_recorded_crops(folder: Path, tiny_workspace: Workspace) -> None:
    coco = tiny_workspace.export("coco")
    recorded = KeypointDataset(coco, split="train", input_px=64, heatmap_px=16)[0]
    rendered = views(folder, augment=Augmentation(background=0.5))[0]
    assert rendered.keys() == recorded.keys()
    for name, value in recorded.items():
        if isinstance(value, torch.Tensor):
            assert rendered[name].dtype == value.dtype and rendered[name].ndim == value.ndim, name


def test_keypoints_lie_where_opencv_projects_them(folder: Path) -> None:
    torch.manual_seed(0)
    sample = views(folder)[1]
    pose = sample["camera_from_object"].numpy()
    uv, _ = cv2.projectPoints(CORNERS, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], CAMERA.matrix, None)
    known = sample["visibility"].numpy() > 0
    np.testing.assert_allclose(sample["keypoints_px"].numpy()[known], uv[known, 0], atol=1e-6)
    assert {1, 2} == set(sample["visibility"][known].tolist())  # a cube hides one of its corners at least
    # The nearest corner is in the middle of the cube: its colour is a face's, not the table's.
    affine, nearest = sample["crop_from_image"].numpy(), np.argmin((CORNERS @ pose[:3, :3].T)[:, 2])
    u, v = (affine[:, :2] @ uv[nearest, 0] + affine[:, 2]).round().astype(int)
    shown = 255 * sample["image"][:, v, u].numpy()
    assert np.abs(shown - 90).max() > 20 and shown.max() <= COLORS.max() * 1.2


def test_the_crop_of_one_keypoint_shows_the_whole_object(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "studio", tmp_path / "studio")
    file = tmp_path / "studio" / "studio.json"
    content = json.loads(file.read_text())
    for name in ("keypoints", "points_object"):
        content["subjects"]["cube"][name] = content["subjects"]["cube"][name][:1]
    file.write_text(json.dumps(content))
    torch.manual_seed(0)
    sample = views(tmp_path)[0]
    assert sample["square_box"][2] > 30 and sample["image"].std() > 0.02


def test_a_seed_gives_the_same_views_in_any_process(folder: Path) -> None:
    dataset = views(folder, augment=PLAIN)
    torch.manual_seed(3)
    first, second = dataset[0], dataset[0]
    torch.manual_seed(3)
    again = pickle.loads(pickle.dumps(dataset))[0]
    assert torch.equal(first["image"], again["image"]) and not torch.equal(first["image"], second["image"])
    assert len(pickle.dumps(dataset)) < 2e5
    batch = next(iter(DataLoader(dataset, batch_size=5, num_workers=1)))
    assert batch["image"].shape == (5, 3, 64, 64) and batch["image_id"].tolist() == list(range(5))


def test_a_share_of_the_recorded_crops_is_rendered(folder: Path) -> None:
    rendered = views(folder)

    class Recorded:
        model, augment = rendered.model, None

        def __len__(self) -> int:
            return 40

        def __getitem__(self, row: int) -> dict:
            return {"image_id": 1000 + row}

    torch.manual_seed(0)
    both = PartlySynthetic(Recorded(), rendered, 0.5)
    kinds = [both[row]["image_id"] == 1000 + row for row in range(len(both))]
    assert len(kinds) == 40 and 10 < sum(kinds) < 30
    with pytest.raises(DataError, match="expected 0 to 1"):
        PartlySynthetic(Recorded(), rendered, 1.5)


def test_what_cannot_be_rendered_is_said(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="run `rpl synthesize` first"):
        SyntheticKeypoints(tmp_path, object="cube")
    with pytest.raises(DataError, match="there are cube"):
        SyntheticKeypoints(folder, object="mug")
    with pytest.raises(DataError, match="recorded crops"):
        views(folder, augment=Augmentation(occluders=0.3))
    with pytest.raises(IndexError):
        views(folder)[5]


def test_views_of_a_tested_scene_or_of_other_keypoints_are_refused(folder: Path, tmp_path: Path) -> None:
    rendered = views(folder)
    (tmp_path / "test.json").write_text(json.dumps({"images": [{"scene": rendered.scenes[0]}]}))

    class Recorded(KeypointDataset):
        model, augment, folder = rendered.model, None, tmp_path
        input_px, heatmap_px, sigma_px = 64, 16, 1.0

        def __init__(self) -> None:
            """Without an export."""

        def __len__(self) -> int:
            return 3

    with pytest.raises(DataError, match=f"scene {rendered.scenes[0]}, which .* has in its test split"):
        partly_synthetic(Recorded(), folder, 0.5)
    (tmp_path / "test.json").unlink()
    assert len(partly_synthetic(Recorded(), folder, 0.5)) == 3
    Recorded.model = replace(rendered.model, points_object=rendered.model.points_object + 0.002)
    with pytest.raises(DataError, match="keypoints of cube at other places"):
        partly_synthetic(Recorded(), folder, 0.5)
