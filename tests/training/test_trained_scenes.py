"""Networks know the scenes again that they were trained on, by an image of each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from rpl_data.formats.datasets.coco import header, image_to_coco
from rpl_data.types import DataError, Frame, Intrinsics
from training.runs.folder import TRAINED_ON
from training.runs.trained_scenes import (
    joined,
    other_images,
    samples_before,
    say_trained,
    scene_samples,
    trained_scenes,
)


def split(folder: Path, name: str, scenes: dict[str, bytes]) -> Path:
    images = []
    for number, (scene, content) in enumerate(scenes.items(), start=1):
        file = folder / f"images/{scene}/000000.jpg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
        entry = image_to_coco(
            number,
            Frame(0, 0.0, file, None),
            scene=scene,
            intrinsics=Intrinsics(4.0, 4.0, 2.0, 2.0, 4, 4),
            scene_from_camera=np.eye(4),
            file_name=str(file.relative_to(folder)),
            depth_file_name=None,
            metres_per_unit=None,
        )
        images.append(entry)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(header([]) | {"images": images, "annotations": []}))
    return path


def checkpoint(path: Path, train_json: Path) -> Path:
    torch.save({"epoch": 0, "run": {"seed": 0, TRAINED_ON: scene_samples(train_json)}}, path)
    return path


def test_a_test_scene_that_was_trained_on_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trained = checkpoint(tmp_path / "last.ckpt", split(tmp_path / "a", "train", {"00": b"one", "01": b"two"}))
    unseen = split(tmp_path / "a", "test", {"02": b"three"})
    assert trained_scenes(trained, unseen) == []
    anew = split(
        tmp_path / "a", "test", {"01": b"two", "02": b"three"}
    )  # other scenes were chosen to test on
    say_trained([trained], anew)
    said = capsys.readouterr().out
    assert "was trained on scene 01 or views of it, or chosen by it: what" in said and "00" not in said
    of_others = split(tmp_path / "b", "test", {"01": b"another recording's"})
    assert trained_scenes(trained, of_others) == []
    torch.save({"epoch": 0}, old := tmp_path / "old.ckpt")
    assert trained_scenes(old, anew) == []  # an earlier version says nothing of its scenes


def test_scenes_that_views_were_rendered_from_are_known(tmp_path: Path) -> None:
    """Rendered images are of no recording, and none of them is in the test split of a later export."""
    made_of = scene_samples(split(tmp_path / "a", "train", {"00": b"one", "01": b"two"}))
    views = split(tmp_path / "views", "train", {"synthetic": b"rendered"})
    content = json.loads(views.read_text())
    content["rpl"]["synthetic"] = {"images_of": made_of}
    views.write_text(json.dumps(content))
    trained = checkpoint(tmp_path / "last.ckpt", views)
    assert trained_scenes(trained, split(tmp_path / "a", "test", {"01": b"two", "02": b"three"})) == ["01"]
    content["rpl"]["synthetic"] = {"images_of": {"01": [3]}}
    views.write_text(json.dumps(content))
    with pytest.raises(DataError, match="train.json.*synthesize"):
        scene_samples(views)


def test_scenes_stay_known_when_a_run_goes_on_with_others(tmp_path: Path) -> None:
    trained = checkpoint(tmp_path / "last.ckpt", split(tmp_path / "a", "train", {"00": b"one", "01": b"two"}))
    before = samples_before(trained, "scratch")
    assert before == samples_before(None, str(trained)) and samples_before(None, "scratch") == {}
    now = scene_samples(split(tmp_path / "b", "train", {"00": b"another", "02": b"three"}))
    assert other_images(before, before) == [] and other_images(before, now) == ["00"]
    both = joined(before, now)
    assert sorted(both) == ["00", "01", "02"] and len(both["00"]) == 2
    assert other_images(both, both) == []  # two contents under one name are both known
