"""The command `rpl`: every command once, and every mistake one line and status 1."""

from __future__ import annotations

import inspect
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from built_once import moved_copy, plain_recipe

from rpl_data.cli.main import COMMANDS, main
from rpl_data.types import Click
from rpl_data.workspace.workspace import Workspace


@pytest.fixture
def recipe(tiny_workspace: Workspace, tmp_path: Path) -> Path:
    """A recipe, beside a copy of the tiny recording that may be spoilt."""
    shutil.copytree(tiny_workspace.recording, tmp_path / "recording")
    return plain_recipe(tmp_path)


@pytest.fixture
def mistake(recipe: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., str]:
    """Run a command that must fail, and return the one line it says."""

    def run(*arguments: str) -> str:
        told = arguments or ("build", str(recipe), "--workspace", str(tmp_path / "ws"), "--workers", "1")
        assert main(told) == 1
        error = capsys.readouterr().err
        assert error.startswith("rpl: ") and error.count("\n") == 1, error
        return error

    return run


def spoil(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def test_help_is_quick_and_names_every_command() -> None:
    code = (
        "import sys; from rpl_data.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in ('torch', 'open3d', 'cv2', 'scipy', 'plotly') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert all(f"    {name}" in done.stdout for name in COMMANDS)


@pytest.mark.parametrize("command", [name for name, command in COMMANDS.items() if callable(command)])
def test_every_command_explains_its_arguments(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    arguments = re.search(r"positional arguments:.*|options:.*", capsys.readouterr().out, re.S)
    assert arguments is not None
    words = " ".join(arguments[0].split())
    described = inspect.getdoc(COMMANDS[command]).partition("Args:")[2]
    for name in inspect.signature(COMMANDS[command]).parameters:
        meaning = re.search(rf"\b{name}: (\S+)", described)
        assert meaning and name.rstrip("_") in words and meaning[1] in words, name


def test_a_command_a_stage(plain_build: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = json.loads((plain_build / "said.json").read_text())
    assert set(said) == {"import", "solve", "surface", "segment", "label", "export", "report"}
    assert all(f"\n{command}" in "\n" + out for command, out in said.items())
    copy = moved_copy(plain_build, tmp_path / "copy")
    at = ["--workspace", str(copy / "ws")]
    assert main(["status", *at]) == 0
    out = capsys.readouterr().out
    assert "to run" not in out and "quality   not asked for" in out
    assert main(["build", str(copy / "recipe.yaml"), *at]) == 0
    out = capsys.readouterr().out
    assert "nothing to do" in out and str(Workspace(copy / "ws").report) in out


def test_status_before_a_build(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(recipe), "--workspace", str(tmp_path / "ws")]) == 0
    assert main(["status", "--workspace", str(tmp_path / "ws")]) == 0
    out = capsys.readouterr().out
    assert "clicks    to run: carton" in out
    assert "label     waits for the stages before it" in out


def test_build_prints_errors_speeds_and_the_report(
    tiny_workspace: Workspace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "--workspace", str(tiny_workspace.root)]) == 0
    out = capsys.readouterr().out
    assert "frames/s" in out and "carton" in out and "3D mm" in out
    assert f"report: {tiny_workspace.report}" in out


def test_truth_is_exported_with_the_same_images(
    tiny_workspace: Workspace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "--labels", "truth", "--workspace", str(tiny_workspace.root)]) == 0
    own, truth = (
        json.loads((tiny_workspace.export(name) / "train.json").read_text())
        for name in ("coco", "coco_truth")
    )
    ids = [[(image["id"], image["file_name"]) for image in data["images"]] for data in (own, truth)]
    assert ids[0] == ids[1]


def test_labels_corrected_elsewhere_come_back(
    plain_build: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They survive new labels; a later version of the file replaces them, and they can be dropped."""
    place = Workspace(moved_copy(plain_build, tmp_path / "copy") / "ws")
    at, file, exported = ["--workspace", str(place.root)], tmp_path / "edited.json", place.export("coco")

    def annotations() -> dict[int, dict[str, object]]:
        return {one["id"]: one for one in json.loads((exported / "train.json").read_text())["annotations"]}

    def said(*arguments: str) -> str:
        assert main([*arguments, *at]) == 0
        return capsys.readouterr().out

    edited, before = json.loads((exported / "train.json").read_text()), annotations()
    first, second = edited["annotations"][:2]
    first["keypoints"][:3] = [50.0, 40.0, 2]
    second["iscrowd"] = 1
    file.write_text(json.dumps(edited))
    out = said("labels", "import", str(file))
    assert "1 keypoint of 1 instance changed" in out and "1 instance marked as ignored" in out
    assert "export    to run: coco" in said("status")
    said("label", "--again", "true", "--workers", "1")
    assert "corrected with another program: keypoints of 1 instance moved" in said("export")
    after = annotations()
    assert [key for key in after if after[key] != before[key]] == [first["id"], second["id"]]
    assert after[first["id"]]["keypoints"][:3] == [50.0, 40.0, 2]
    assert after[first["id"]]["corrected"] and after[second["id"]]["iscrowd"] == 1

    again = json.loads((exported / "train.json").read_text())
    again["annotations"][1]["iscrowd"] = 0
    file.write_text(json.dumps(again))
    out = said("labels", "import", str(file))
    assert "1 keypoint of 1 instance changed" in out and "they replace 2 earlier corrections" in out
    kept = place.corrections_file.read_bytes()
    file.write_text(json.dumps(again)[:-9])
    assert main(["labels", "import", str(file), *at]) == 1
    assert capsys.readouterr().err.count("\n") == 1 and place.corrections_file.read_bytes() == kept

    assert said("labels", "forget") == "1 correction dropped\n"
    said("export")
    assert annotations() == before and not place.corrections_file.exists()


def test_clicks_go_out_and_in(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, table = Workspace(tmp_path / "ws"), tmp_path / "clicks.csv"
    at = ["--workspace", str(place.root)]
    assert main(["import", str(recipe), *at]) == 0
    original = tmp_path / "recording" / "clicks.csv"
    assert main(["clicks", "import", str(original), *at]) == 0
    assert main(["clicks", "export", str(table), *at]) == 0
    assert sorted(table.read_text().splitlines()) == sorted(original.read_text().splitlines())
    before = place.load_annotation("carton").clicks
    moved = f"carton,{before[0].keypoint},{before[0].scene},{before[0].frame},10,20"
    table.write_text(f"object,keypoint,scene,frame,u_px,v_px\n{moved}\n")
    capsys.readouterr()
    assert main(["clicks", "import", str(table), *at]) == 0
    others = len(before) - 1
    assert capsys.readouterr().out == f"carton: 1 click moved; {others} stay as before\n"
    after = place.load_annotation("carton").clicks
    assert Click("carton", before[0].keypoint, before[0].scene, before[0].frame, 10.0, 20.0) in after
    assert len(after) == len(before)
    assert main(["clicks", "import", str(table), *at, "--replace=true"]) == 0
    assert capsys.readouterr().out == f"carton: {others} clicks removed; 1 stays as before\n"
    assert len(place.load_annotation("carton").clicks) == 1
    assert main(["clicks", "import", str(table), *at, "--replace=true", "--proposed=true"]) == 1


UNUSABLE = {
    "carton,0,01,600,10,20": "keypoint 0 top_back_left: scene 01 has no frame 600",
    "carton,0,7,0,10,20": "clicks in scene 7; the workspace has the scenes 00, 01, 02",
    "carton,0,01,3,320,20": "(320.0, 20.0) px lies outside the image of scene 01",
}


def test_clicks_that_no_solve_could_use_are_not_added(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place, table = Workspace(tmp_path / "ws"), tmp_path / "clicks.csv"
    at = ["--workspace", str(place.root)]
    assert main(["import", str(recipe), *at]) == 0
    for row, fault in UNUSABLE.items():
        table.write_text(f"object,keypoint,scene,frame,u_px,v_px\n{row}\n")
        assert main(["clicks", "import", str(table), *at]) == 1
        assert fault in capsys.readouterr().err
        assert not place.load_annotation("carton").clicks


def test_proposed_clicks_only_fill_in(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place, table = Workspace(tmp_path / "ws"), tmp_path / "recording" / "clicks.csv"
    at = ["--workspace", str(place.root)]
    heading, first, *rest = table.read_text().splitlines(keepends=True)
    _, keypoint, scene, *_ = first.split(",")
    mine = [line for line in rest if line.split(",")[1:3] != [keypoint, scene]]
    table.write_text(heading + "".join(mine))
    assert main(["import", str(recipe), *at]) == 0
    assert main(["clicks", "import", str(table), *at]) == 0
    before = set(place.load_annotation("carton").clicks)
    proposals = tmp_path / "proposals.csv"
    moved = [",".join([*line.split(",")[:4], "1.0", "2.0\n"]) for line in mine]
    proposals.write_text(heading + first + "".join(moved))
    capsys.readouterr()
    assert main(["clicks", "import", str(proposals), *at, "--proposed=true"]) == 0
    assert "carton: 1 click added; " in capsys.readouterr().out
    after = set(place.load_annotation("carton").clicks)
    assert before < after and len(after) == len(before) + 1


def test_register_places_a_scene_and_keeps_the_model(
    known_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = moved_copy(known_model, tmp_path / "copy")
    place, later = Workspace(copy / "ws"), copy / "later.csv"
    at = ["--workspace", str(place.root)]
    model = place.load_placed("carton").model
    assert main(["register", "carton", "02", "--auto", "true", *at]) == 0, "no click there yet"
    found = place.load_placements("carton")["02"]
    capsys.readouterr()
    assert main(["status", *at]) == 0
    said = capsys.readouterr().out
    assert "carton in scene 02: placed automatically, checked by colours and free space" in said
    assert main(["clicks", "import", str(later), *at]) == 0
    capsys.readouterr()
    assert main(["register", "carton", "02", *at]) == 0
    said = capsys.readouterr().out
    assert re.search(r"keypoints are expected to be [\d.]+ mm \([\d.]+ px\) off", said)
    assert "was aligned to the surface and colours" in said or "stays where its clicks put it" in said
    placed = place.load_placements("carton")["02"]
    off = np.linalg.inv(placed.scene_from_object) @ found.scene_from_object
    assert np.linalg.norm(off[:3, 3]) < 0.003, "found without clicks where the clicks put it"
    np.testing.assert_array_equal(placed.points_object, model.points_object)
    assert main(["label", *at, "--workers", "1"]) == 0
    np.testing.assert_allclose(place.load_placed("carton").model.points_object, model.points_object)
    np.testing.assert_allclose(
        place.load_placed("carton").scene_from_object["02"], placed.scene_from_object, atol=1e-6
    )
    assert set(place.load_placed("carton").covariance_in_scene) == {"00", "01", "02"}
    assert place.labels_file("02").exists()
    assert main(["register", "carton", "99", *at]) == 1
    assert "has no scene '99'" in capsys.readouterr().err
    assert main(["status", *at]) == 0
    assert "solve     up to date" in capsys.readouterr().out, "a mistake leaves everything as it was"
    assert main(["solve", *at, "--again", "true"]) == 0, "solved again, the registered scene follows"
    assert set(place.load_solution("carton").scene_from_object) == {"00", "01", "02"}
    moved = tmp_path / "moved.csv"
    heading, *others = (copy / "recording" / "clicks.csv").read_text().splitlines()
    first = next(line for line in others if ",00," in line).rsplit(",", 2)[0]
    moved.write_text(f"{heading}\n{first},9.0,9.0\n")
    assert main(["clicks", "import", str(moved), *at]) == 0
    capsys.readouterr()
    assert main(["register", "carton", "02", *at]) == 1
    assert "in scene 00 have changed since its model was solved" in capsys.readouterr().err


# Mistakes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("carton,0,7,3,10,10", "scene '7', which is not in the workspace; the scenes are 00, 01, 02"),
        ("carton,0,01,600,10,10", "scene 01 has no frame 600"),
        ("carton,0,01,3,640,10", "(640.0, 10.0) px lies outside the image of 320 x 240 px"),
        ("carton,lid,01,3,64,10", "carton has no keypoint 'lid'"),
    ],
)
def test_a_click_that_cannot_be(
    mistake: Callable[..., str], plain_build: Path, tmp_path: Path, row: str, said: str
) -> None:
    """In the clicks of a recording that has been built before, so that little runs until it is found."""
    copy = moved_copy(plain_build, tmp_path / "copy")
    with (copy / "recording/clicks.csv").open("a") as file:
        file.write(f"{row}\n")
    assert said in mistake(
        "build", str(copy / "recipe.yaml"), "--workspace", str(copy / "ws"), "--workers", "1"
    )


def test_misspelt_recipe_key(mistake: Callable[..., str], recipe: Path) -> None:
    spoil(recipe, lambda text: text.replace("label:", "lable:"))
    assert "unknown key 'lable'; did you mean 'label'" in mistake()


def test_read_only_output(mistake: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "ws").write_text("a file where the workspace should be: not even root can write into it")
    assert f"cannot write {tmp_path / 'ws' / 'build.lock'}" in mistake()


def test_full_disk(mistake: Callable[..., str], full_disk: Callable[..., object], tmp_path: Path) -> None:
    with full_disk(2000):  # type: ignore[attr-defined]
        assert "nothing was changed" in mistake()
    assert [path.name for path in (tmp_path / "ws").rglob("*") if path.name.startswith(".")] == []


def test_object_that_never_enters_the_image(
    mistake: Callable[..., str], recipe: Path, tmp_path: Path
) -> None:
    """Only the first frame of every scene is labelled, and there the camera looks the other way."""
    recording = tmp_path / "recording"
    lines = (recording / "clicks.csv").read_text().splitlines(keepends=True)
    wanted = [line for line in lines if ",02," not in line and line.split(",")[3] != "0"]
    (recording / "clicks.csv").write_text("".join(wanted))
    for poses in recording.glob("*/camera.poses"):
        spoil(poses, turn_the_first_camera_round)
    spoil(recipe, lambda text: text.replace("rate: all", "rate: 0.1"))
    spoil(recipe, lambda text: text.replace("recording, metres", 'recording, names: ["00", "01"], metres'))
    spoil(recipe, lambda text: text + "refine: {scenes: false}\n")  # quicker, and not what is looked at
    assert "object carton is in none of the 2 labelled frames" in mistake()


def turn_the_first_camera_round(text: str) -> str:
    """Half a turn about the camera's y axis: q * (0, 1, 0, 0)."""
    lines = text.splitlines()
    first = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    *place, x, y, z, w = (float(value) for value in lines[first].split())
    turned = [*place, -z, w, x, -y]
    lines[first] = " ".join(repr(value) for value in turned)
    return "\n".join(lines) + "\n"


def test_missing_camera(mistake: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "recording/camera.txt").unlink()
    assert "camera.txt" in mistake()


def test_forgotten_root(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "elsewhere").mkdir()
    at = ["--root", str(tmp_path / "elsewhere"), "--workspace", str(tmp_path / "ws")]
    spoil(recipe, lambda text: text.replace("path: recording", "path: ."))
    assert main(["import", str(recipe), *at]) == 1
    assert "elsewhere holds no recording" in capsys.readouterr().err


def test_not_a_workspace(mistake: Callable[..., str], tmp_path: Path) -> None:
    assert "is not a workspace" in mistake("status", "--workspace", str(tmp_path / "nothing"))
    cup = tmp_path / "mine/workspaces/cup"
    cup.mkdir(parents=True)
    (cup / "stages.json").write_text("{}")
    assert f"name one of those in it: {cup}" in mistake("status", "--workspace", str(tmp_path / "mine"))
    assert "is a workspace without exports" in mistake("check", str(cup))


def test_quality_without_truth(mistake: Callable[..., str], plain_build: Path, tmp_path: Path) -> None:
    copy = moved_copy(plain_build, tmp_path / "copy")
    assert "the truth of" in mistake("quality", "--workspace", str(copy / "ws"))


def test_unknown_stage_to_run_again(mistake: Callable[..., str], recipe: Path) -> None:
    assert "there is no stage 'labels'" in mistake("build", str(recipe), "--again", "labels")


def test_unknown_export(mistake: Callable[..., str], recipe: Path) -> None:
    spoil(recipe, lambda text: text + "export: [coco, kitti]\n")
    assert "unknown export 'kitti'" in mistake()
