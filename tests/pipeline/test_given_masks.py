"""Masks that the recipe names: whose they are, what they change, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from built_once import moved_copy
from pycocotools import mask as coco_masks

from rpl_data.cli.main import main
from rpl_data.pipeline.build import context_of
from rpl_data.pipeline.given_masks import instances_in, object_masks
from rpl_data.pipeline.recipe_file import load_recipe, recipe_to_yaml
from rpl_data.types import DataError
from rpl_data.workspace.parts import Parts
from rpl_data.workspace.workspace import Workspace


def write_true_masks(folder: Path, *, number: int = 7) -> list[str]:
    """The true masks as numbers, a folder per scene, but for the first frame and an empty third."""
    truth, names = Workspace(folder / "recording/truth"), Workspace(folder / "ws").scene_names()
    for name in names:
        stems = {frame.index: frame.color.stem for frame in Workspace(folder / "ws").load_scene(name).frames}
        (folder / "masks" / name).mkdir(parents=True)
        for row, label in enumerate(truth.load_labels(name)):
            ids = np.zeros(label.instances[0].mask["size"], np.uint8)
            if row != 2:
                ids[coco_masks.decode(label.instances[0].mask) > 0] = number
            if row:
                cv2.imwrite(str(folder / "masks" / name / f"{stems[label.frame]}.png"), ids)
    return names


@pytest.fixture
def with_masks(plain_build: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Copies the build, with masks in its recipe."""

    def copied(said: str) -> Path:
        folder = moved_copy(plain_build, tmp_path / "copy")
        recipe = folder / "recipe.yaml"
        recipe.write_text(
            recipe.read_text().replace("metres_per_unit", f"masks: {{{said}}}, metres_per_unit")
        )
        write_true_masks(folder)
        (folder / "ws/recipe.yaml").write_text(recipe_to_yaml(load_recipe(recipe)))
        return folder

    return copied


def test_clicks_tell_whose_a_mask_is_and_labels_are_checked(
    with_masks: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = with_masks("path: masks")
    assert main(["label", "--workspace", str(folder / "ws")]) == 0
    said = capsys.readouterr().out
    assert "given mask 7 is taken for carton" in said and "have no given mask" in said
    assert "IoU of labels with given masks is 0.9" in said
    assert "given masks and labels of 1 frame disagree" in said
    assert main(["label", "--workspace", str(folder / "ws")]) == 0
    assert "nothing to do" in capsys.readouterr().out
    next((folder / "masks").rglob("*.png")).unlink()
    assert main(["status", "--workspace", str(folder / "ws")]) == 0
    assert "segment   to run: carton" in capsys.readouterr().out


def test_a_workspace_without_masks_stays_as_it_is(plain_build: Path, tmp_path: Path) -> None:
    folder = moved_copy(plain_build, tmp_path / "copy")
    assert object_masks(context_of(Workspace(folder / "ws")), "00") is None


def test_the_recipe_may_say_whose_it_is(with_masks: Callable[[str], Path]) -> None:
    context = context_of(Workspace(with_masks("path: masks, objects: {carton: 7}") / "ws"))
    video = context.workspace.video_names()[0]
    found = object_masks(context, video)
    assert found is not None and found.keys == {"carton": "7"}
    scene = context.workspace.load_scene(video)
    shown = {frame.index: found.mask("carton", frame.index, scene) for frame in scene.frames}
    assert any(mask is not None and mask.any() for mask in shown.values())
    assert found.mask("cup", scene.frames[1].index, scene) is None


def test_an_object_that_is_none_is_said(with_masks: Callable[[str], Path]) -> None:
    context = context_of(Workspace(with_masks("path: masks, objects: {cup: 7}") / "ws"))
    with pytest.raises(DataError, match="names cup, which is no object of the recipe; it has carton"):
        object_masks(context, context.workspace.video_names()[0])


def test_frames_in_which_a_moved_object_was_clicked_are_one_instance(plain_build: Path) -> None:
    solution = Workspace(plain_build / "ws").load_placed("carton")
    (one, *others) = sorted(solution.scene_from_object)
    poses = {name: solution.scene_from_object[name] for name in others}
    moved = dict.fromkeys((f"{one}/@4", f"{one}/@9"), solution.scene_from_object[one])
    parts = Parts({}, frozenset({one}))
    assert instances_in(replace(solution, scene_from_object=poses | moved), one, parts) == {""}
    both = {one: solution.scene_from_object[one], f"{one}/2": solution.scene_from_object[one]}
    assert instances_in(replace(solution, scene_from_object=poses | both), one, Parts({})) == {"", "2"}
