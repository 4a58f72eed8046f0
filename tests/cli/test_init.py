"""`rpl init` and `rpl import` of a lone recording."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from rpl_data.cli.main import main
from rpl_data.cli.new_recipe import assumed, next_commands
from rpl_data.pipeline.build import recipe_of
from rpl_data.pipeline.recipe_file import load_recipe
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def recording(tiny_workspace: Workspace, tmp_path: Path) -> Path:
    """One scene with its camera, and no clicks."""
    to = tmp_path / "lone"
    shutil.copytree(tiny_workspace.recording, to)
    (to / "clicks.csv").unlink()
    for scene in sorted(to.glob("*/rgb"))[1:]:
        shutil.rmtree(scene.parent)
    return to


def test_the_next_commands_can_be_pasted_where_a_path_holds_a_space() -> None:
    build = next_commands(Path("my recipes/mug 2.yaml"), clicked=True).split("dataset:  ")[1]
    expected = ["rpl", "build", "my recipes/mug 2.yaml", "--workspace", "workspaces/mug 2"]
    assert shlex.split(build) == expected


def test_what_nobody_said_of_the_object_is_said() -> None:
    assert assumed(None, "4") == "that the object is called 'object'"
    assert assumed("mug", None) == "8 keypoints without names" and assumed("mug", "4") == ""


def test_a_recipe_for_a_recording(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = tmp_path / "my.yaml"
    told = ["init", str(recipe), "--from", str(recording), "--object", "mug", "--keypoints", "rim, yes,'no'"]
    assert main(told) == 0
    said = capsys.readouterr().out
    assert "scene 00:" in said and "what to do" not in said, "rpl check says it in full"
    assert f"rpl annotate workspaces/my --recipe {recipe}" in said
    loaded = load_recipe(recipe)
    assert (loaded.name, loaded.objects[0].name) == ("my", "mug")
    assert loaded.objects[0].keypoints == ("rim", "yes", "'no'")
    assert loaded.scenes[0].path == recording and loaded.scenes[0].format == "rpl"
    before = recipe.read_bytes()
    assert main(told) == 1  # never replaced
    assert "is not replaced" in capsys.readouterr().err and recipe.read_bytes() == before


def test_objects_that_are_clicked_come_with_their_keypoints(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = tmp_path / "my.yaml"
    assert main(["init", str(recipe), "--from", str(tiny_workspace.recording)]) == 0
    assert "make the dataset:  rpl build" in capsys.readouterr().out
    for item in load_recipe(recipe).objects:
        assert item.clicks == tiny_workspace.recording / "clicks.csv" and item.keypoint_names


def test_a_lone_recording_is_imported_and_keeps_its_recipe(recording: Path, tmp_path: Path) -> None:
    place = Workspace(tmp_path / "ws")
    told = ["import", str(recording), "--workspace", str(place.root)]
    assert main([*told, "--object", "mug", "--keypoints", "5"]) == 0
    assert place.scene_file("00").exists()
    assert main(told) == 0
    assert [item.name for item in recipe_of(place).objects] == ["mug"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["my.txt"], "rpl init my.yaml"),
        (["nowhere/my.yaml"], "there is no folder nowhere"),
        (["my.yaml", "--object", "a/b"], "cannot be the name of an object"),
        (["my.yaml", "--object", "mug", "--keypoints", "lid"], "how many keypoints"),
    ],
)
def test_mistakes(
    options: list[str],
    words: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["init", *options, "--from", str(recording)]) == 1
    assert words in capsys.readouterr().err and not list(tmp_path.glob("*.yaml"))


def test_a_recording_of_two_formats_is_not_guessed(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "a.klg").touch()
    for command in (["check", str(recording)], ["init", str(tmp_path / "my.yaml"), "--from", str(recording)]):
        assert main(command) == 1
        assert "looks like rpl and like klg; give `format` (--format), one of" in capsys.readouterr().err
