"""A build of scenes that show an object twice, and of one in which it is carried about."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rpl_data.evaluate.quality import compare_workspaces, label_errors
from rpl_data.files import read_json
from rpl_data.pipeline.build import build
from rpl_data.pipeline.context import Context
from rpl_data.pipeline.ledger import Ledger
from rpl_data.pipeline.pool import Pool
from rpl_data.pipeline.recipe import Recipe, SceneSource
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.pipeline.sources import recordings_of
from rpl_data.pipeline.stages.import_ import import_steps
from rpl_data.pipeline.stages.solve import instances_in_one_place
from rpl_data.types import DataError
from rpl_data.workspace.workspace import Workspace

RECIPE = """
name: several
twin:
  objects: [carton]
  scenes:
    - {objects: [carton, carton]}
    - {objects: [carton]}
    - {objects: [carton], moving: true}
  seconds: 0.5
  rate_hz: 12
  width: 320
  height: 240
  clicks_per_keypoint: 2
  click_noise_px: 0.5
  clutter: 1
  seed: 3
reconstruct: {method: given}
label: {rate: all}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    folder = tmp_path_factory.mktemp("several")
    (folder / "several.yaml").write_text(RECIPE)
    build(load_recipe(folder / "several.yaml"), Workspace(folder / "ws"), until="export", workers=1)
    return Workspace(folder / "ws")


def test_both_instances_are_placed_labelled_and_exported(built: Workspace) -> None:
    truth = Workspace(built.truth)
    placed = built.load_placed("carton").scene_from_object
    assert {"00", "00/2", "01"} <= placed.keys()
    for label in built.load_labels("00"):
        assert [one.instance for one in label.instances] == ["", "2"]
    found = label_errors(built.load_labels("00"), truth.load_labels("00"))["carton"]
    assert (len(found.instances), found.missed, found.invented) == (12, 0, 0)
    assert np.mean([error.mean_px for error in found.instances]) < 1.5
    assert np.mean([error.iou_full for error in found.instances]) > 0.9
    exported = [one for name in ("train", "val") for one in _annotations(built, name)]
    assert sum(one.get("instance") == "2" for one in exported) == 6


def test_a_carried_object_is_followed_or_lost_and_never_labelled_wrongly(built: Workspace) -> None:
    labels = list(built.load_labels("02"))
    found = label_errors(labels, Workspace(built.truth).load_labels("02"))["carton"]
    assert len(labels) >= 2 and max(error.mean_px for error in found.instances) < 4
    stated_px = np.sqrt(np.mean([np.nanmean(one.sigma_px**2) for each in labels for one in each.instances]))
    real_px = np.sqrt(np.mean([np.nanmean(error.keypoints_px**2) / 2 for error in found.instances]))
    assert 1 / 3 < real_px / stated_px < 3, "the error of followed objects is measured where they stand still"
    said = " ".join(Ledger(built.stages_file).of_stage("label")["02"].outcome.messages)
    assert f"followed through {'all' if len(labels) == 6 else len(labels)}" in said
    said = " ".join(one.text for one in built.load_solution("carton").statements)
    assert "@" not in said and "in another frame than" not in said
    (row,) = compare_workspaces(built, Workspace(built.truth))
    assert row.invented == 0


def test_one_object_marked_as_two_instances_is_said(built: Workspace) -> None:
    solution = built.load_solution("carton")
    assert instances_in_one_place(solution) == []
    places = solution.scene_from_object
    (line,) = instances_in_one_place(replace(solution, scene_from_object={**places, "00/2": places["00"]}))
    assert line.startswith("00 and 00/2 are in one place: their keypoints lie 0.0 mm apart")


def test_a_build_that_is_up_to_date_stays_so(built: Workspace) -> None:
    told = []
    build(
        load_recipe(built.recipe_file),
        built,
        until="export",
        workers=1,
        tell=lambda step: told.append(step.state),
    )
    assert set(told) == {"kept"}


def test_moving_scenes_that_are_not_there_are_named(built: Workspace) -> None:
    source = SceneSource(built.recording, metres_per_unit=0.001, moving=("02", "kitchen"))
    with pytest.raises(DataError, match="`moving` names kitchen; there are 00, 01, 02"):
        recordings_of([source])


def test_what_was_imported_before_scenes_could_move_stays_imported(tmp_path: Path) -> None:
    recipe = Recipe("old", scenes=(SceneSource(tmp_path),))
    (step,) = import_steps(Context(recipe, Workspace(tmp_path / "ws"), Pool(1)))
    assert "moving" not in json.dumps(step.options)


def _annotations(workspace: Workspace, split: str) -> list[dict]:
    path = workspace.export("coco") / f"{split}.json"
    return read_json(path)["annotations"] if path.exists() else []
