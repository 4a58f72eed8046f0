"""The one rule for names, and everything that goes by it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rpl_data.clicks.table import clicks_from_csv
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.types import DataError
from rpl_data.untrusted.names import checked_keypoints, checked_name
from rpl_data.untrusted.rle import pixels_of_rle
from rpl_data.workspace.workspace import Workspace

BAD = [
    "", ".", "..", "../../../x", "a/b", "a\\b", "/etc", ".hidden", " a", "a ", "a\nb", "a\0b", "\u202ea",
    "\ud800", "a" * 101, "\u8336" * 67,
]  # fmt: skip
GOOD = ["00", "00.1", "carton", "006_mustard_bottle", "picture cube", "K\u00fchlschrank", "left-corner (top)"]


@pytest.mark.parametrize("name", BAD)
def test_a_name_that_could_leave_its_folder_or_not_be_shown_is_refused_everywhere(
    name: str, tmp_path: Path
) -> None:
    workspace = Workspace(tmp_path)
    files: list[Callable[[str], Path]] = [
        workspace.scene_file, workspace.cache, workspace.images, workspace.labels_file,
        workspace.left_out_file, workspace.clicks_file, workspace.mesh_file, workspace.solution_file,
    ]  # fmt: skip
    for file in files:
        with pytest.raises(DataError, match="cannot be the name of"):
            file(name)
    with pytest.raises(DataError, match="cannot be the name of a keypoint"):
        checked_keypoints(["a", name, "c"], where="here")
    recipe = f"name: x\nscenes: [{{path: a}}]\nobjects: [{{name: {name!a}, keypoints: 3}}]\n"
    (tmp_path / "recipe.yaml").write_text(recipe.replace("'", '"'))
    with pytest.raises(DataError, match="cannot be the name of an object|not valid YAML"):
        load_recipe(tmp_path / "recipe.yaml")


@pytest.mark.parametrize("name", GOOD)
def test_usual_names_are_taken_as_they_are(name: str) -> None:
    assert checked_name(name, "scene") == name
    assert Workspace(Path("ws")).mesh_file(name) == Path("ws/objects") / name / "mesh.ply"


def test_keypoints_are_neither_doubled_nor_without_number() -> None:
    with pytest.raises(DataError, match="two keypoints are called 'a'"):
        checked_keypoints(["a", "b", "a"], where="here")
    with pytest.raises(DataError, match="1 to 200 keypoints, not 201"):
        checked_keypoints(map(str, range(201)), where="here")


HEAD = "object,keypoint,scene,frame,u_px,v_px\n"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("cup,0,00,1,57,3017,80\n", "line 2: expected 6 values, found more; numbers have a decimal"),
        ("cup,0,00,1,57\n", "line 2: expected 6 values, found fewer"),
        ("cup,0,00,1,5_7,80\n", "line 2.*5_7"),
        ("cup,0,00,1.5,57,80\n", "line 2: frame must be a whole number"),
        ("cup,0,00,1,57,80\ncup,0,00,1,57,80\ncup,0,00,1,99,80\n", "lines 2 and 4 put keypoint 0"),
        (f"cup,0,00,1,57,{'8' * 140_000}\n", "field larger than field limit"),
        ("cup,0,00,1,57,8\0\n", "line"),
    ],
)  # fmt: skip
def test_a_table_of_clicks_that_says_two_things_or_none_is_refused(lines: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        clicks_from_csv(HEAD + lines, source="c.csv", object_name="cup", keypoints=["0", "1", "2"])


def test_a_click_that_is_there_twice_and_blanks_behind_a_line_do_no_harm() -> None:
    lines = "cup,0,00,1,57,80\ncup,0,00,1,57,80,,\n"
    found = clicks_from_csv(HEAD + lines, source="c.csv", object_name="cup", keypoints=["0", "1", "2"])
    assert len(set(found)) == 1


def test_the_pixels_of_packed_masks_are_those_that_pycocotools_counts() -> None:
    from pycocotools import mask

    random = np.random.default_rng(0)
    for share in (0.0, 0.01, 0.5, 0.99, 1.0):
        for _ in range(20):
            height, width = random.integers(1, 90, 2)
            image = np.asfortranarray(random.random((height, width)) < share, dtype=np.uint8)
            assert pixels_of_rle(mask.encode(image)["counts"].decode()) == height * width
    for broken in ("0P", "\u00e9", "000" + "o" * 9, "00@", "~"):
        with pytest.raises(ValueError, match="mask"):
            pixels_of_rle(broken)
