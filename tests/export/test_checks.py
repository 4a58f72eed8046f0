"""Checks of exports: sound ones give no alarm, and each fault is named by file and field."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from export_damage import Damage, damaged, damages, names, one_of_each_kind, write_all, write_dialects
from labelled_scenes import BOX, CAMERA, CAN, labelled_scene, two_boxes
from test_ycb_video import make_sequence

from rpl_data.cli.main import main
from rpl_data.export import export_coco, export_linemod, export_ycb_video, export_yolo
from rpl_data.export.checks import CHECKS, check_export, dialect_of
from rpl_data.export.checksums import NAME, keeping_edited, read_checksums, write_checksums
from rpl_data.export.split import SplitRule
from rpl_data.meshes import load_mesh, save_mesh, simplified
from rpl_data.pipeline.stages.export import EXPORTS
from rpl_data.workspace.workspace import Workspace

NO_READER_NEEDS = {
    "coco": (r"info", r"licenses"),
    "bop": (r"dataset_info\.md", r"scene_gt_coco\.json: (info|licenses|categories\.supercategory)"),
    "assets": (r"mtl: : (word|line)",),  # shading only; that the texture is there is checked
    "ycb_video": (r"mtl: : (word|line)",),
}
"""Fields that are for people, or that no program reads."""

NOTHING_CONTRADICTS = {
    "coco": (
        r"categories\.skeleton: shorter",
        r"objects\.mesh: null",  # an object without a dense model
        r"timestamp_s: no number",
        r"annotations: shorter",  # an instance that is not labelled
        r"sigma_px: null",  # an error that is not known
    ),
    "okt": (r"keypoints\.txt: : word", r"scales_#\.txt: : cut"),  # another name; a number of fewer digits
    "huggingface": (r"timestamp_s: no number",),
    "webdataset": (
        r"tar: : missing",
        r"metres_per_unit: dropped",
        r"timestamp_s: no number",
        r"sigma_px: null",
    ),
    "ycb_video": (r"albedo\.png: : half",),
    "assets": (r"keypoints_m\..*: (null|dropped)", r"albedo\.png: : half"),
}
"""Damage that leaves another sound export: nothing else in it says what was there before."""


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every dialect of two scenes of two frames, as older versions wrote them: without checksums."""
    folder = write_all(tmp_path_factory.mktemp("checks"))
    for written in folder.iterdir():
        (written / NAME).rename(folder.parent / written.name)
    return folder


def test_every_dialect_that_is_written_can_be_checked() -> None:
    unchecked = EXPORTS.keys() - CHECKS.keys()
    assert not unchecked, "write a check beside the new dialect: `rpl_data/export/checks`"


WRITTEN = [name for name in CHECKS if name not in ("coco_per_object", "bop_onboarding")]


@pytest.mark.parametrize("dialect", WRITTEN)
def test_each_fault_is_named_and_soundness_is_not(dialect: str, exports: Path) -> None:
    folder = exports / dialect
    assert dialect_of(folder) == dialect and check_export(folder) == []
    assert [name for name, check in CHECKS.items() if check.looks_like(folder)] == [dialect]
    missed = []
    for damage in _sampled(damages(folder)):
        with damaged(folder, damage):
            said = [str(fault) for fault in check_export(folder, dialect)]
        if not any(names(damage, fault) for fault in said):
            missed.append(f"{damage.pattern} {said[:1]}")
    excused = NO_READER_NEEDS.get(dialect, ()) + NOTHING_CONTRADICTS.get(dialect, ())
    assert not [one for one in missed if not any(re.search(pattern, one) for pattern in excused)]


def _sampled(found: Iterator[Damage]) -> Iterator[Damage]:
    """All damage to whole files, and every eleventh to fields and words; `make bench` tries all."""
    for number, damage in enumerate(found):
        if damage.how in ("missing", "cut", "empty", "half as large", "other bits") or number % 11 == 0:
            yield damage


@pytest.mark.parametrize("dialect", WRITTEN)
def test_checksums_show_swapped_files_and_changed_digits(dialect: str, exports: Path) -> None:
    """Damage that leaves a sound export: a file replaced by another of its kind, one digit made another."""
    folder = exports / dialect
    shutil.copy(exports.parent / dialect, folder / NAME)
    try:
        assert check_export(folder, dialect) == []
        for name, content in _others(folder):
            with damaged(folder, Damage(name, (), "other", content)):
                said = [fault for fault in check_export(folder, dialect) if fault.file == name]
            assert any("changed since it was exported" in fault.problem for fault in said), name
    finally:
        (folder / NAME).unlink()


def _others(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Of each kind, a file with the bytes of another one, and one with its last digit changed."""
    for path in one_of_each_kind(folder):
        name, content = str(path.relative_to(folder)), path.read_bytes()
        alike = (each.read_bytes() for each in sorted(path.parent.glob(f"*{path.suffix}")) if each.is_file())
        swapped = next((other for other in alike if other != content), None)
        if swapped is not None and name != NAME:
            yield name, swapped
        digits = list(re.finditer(rb"[0-8]", content)) if path.suffix in TEXTS and name != NAME else []
        if digits:
            at = digits[-1].start()
            yield name, content[:at] + bytes([content[at] + 1]) + content[at + 1 :]


TEXTS = (".json", ".txt", ".yml", ".yaml", ".jsonl")


def test_sha256sum_reads_the_checksums_and_links_are_not_hashed_twice(exports: Path, tmp_path: Path) -> None:
    shutil.copytree(exports / "coco", tmp_path / "coco")
    write_checksums(tmp_path / "coco", beside=tmp_path / "none")
    export_yolo(tmp_path / "yolo", tmp_path / "coco")
    for name in ("coco", "yolo"):
        run = subprocess.run(
            ["sha256sum", "--check", "--strict", "--quiet", NAME], cwd=tmp_path / name, check=False
        )
        assert run.returncode == 0, "sha256sum finds a file that is not as listed"
    sums = {name: read_checksums(tmp_path / name) for name in ("coco", "yolo")}
    assert sums["yolo"]["pose/images/train/a_000001.png"] == sums["coco"]["images/a/000001.png"]
    image = next((tmp_path / "coco/images").rglob("*.png"))
    image.write_bytes(image.read_bytes()[:-1] + b"x")  # through the link, into both
    export_yolo(tmp_path / "yolo", tmp_path / "coco")
    assert {fault.file for fault in check_export(tmp_path / "coco", "coco")} == {
        str(image.relative_to(tmp_path / "coco"))
    }
    assert not [fault for fault in check_export(tmp_path / "yolo", "yolo") if "changed" in fault.problem]


def test_damaged_and_older_checksums_are_said(
    exports: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(exports / "yolo", tmp_path / "yolo")
    assert main(["check", str(tmp_path / "yolo")]) == 0
    assert "it has no SHA256SUMS, as an older version made it" in capsys.readouterr().out
    for content, what in (("0123  data.yaml\n", "damaged in line 1"), ("", "empty")):
        (tmp_path / "yolo" / NAME).write_text(content)
        (fault,) = check_export(tmp_path / "yolo")
        assert str(fault) == f"SHA256SUMS: {what}; put it back, or export again"


def test_what_was_edited_is_kept_when_the_export_is_made_anew(exports: Path, tmp_path: Path) -> None:
    folder = tmp_path / "coco"
    shutil.copytree(exports / "coco", folder)
    with keeping_edited(folder) as said:  # nobody can tell without checksums
        assert said == ()
    write_checksums(folder, beside=folder)
    with keeping_edited(folder) as said:
        assert said == ()
    train = (folder / "train.json").read_text().replace("1", "2", 1)
    (folder / "train.json").write_text(train)
    (folder / "notes.txt").write_text("mine")
    (folder / "labels.cache").write_text("not mine")
    with pytest.raises(KeyError), keeping_edited(folder) as said:
        raise KeyError
    assert not (tmp_path / "coco_edited").exists()
    for kept in ("coco_edited", "coco_edited2"):
        with keeping_edited(folder) as said:
            assert "2 files of" in said[0] and "(notes.txt, train.json)" in said[0] and kept in said[0]
        assert (tmp_path / kept / "train.json").read_text() == train
        assert sorted(path.name for path in (tmp_path / kept).iterdir()) == ["notes.txt", "train.json"]
    (folder / NAME).write_text("0123  data.yaml\n")
    with keeping_edited(folder) as said:  # nobody can tell which, so all are kept
        assert "may have been edited, as SHA256SUMS is damaged" in said[0]
        assert (tmp_path / "coco_edited3/train.json").read_text() == train


def test_a_built_workspace_gives_no_alarm_and_a_damaged_one_is_named(
    tiny_workspace: Workspace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    coco = tiny_workspace.export("coco")
    assert main(["check", str(coco.parent)]) == 0
    assert f"{coco}: coco: no fault was found" in capsys.readouterr().out
    coarse = tmp_path / "coarse"
    shutil.copytree(coco, coarse)
    mesh = load_mesh(coarse / "meshes/carton.ply")  # a texture is laid on it twice: seconds for thousands
    save_mesh(coarse / "meshes/carton.ply", simplified(mesh, most_triangles=300))
    units = {name: 0.001 for name in tiny_workspace.labelled_scene_names()}
    write_dialects(tmp_path / "export", coarse, units)
    chosen = tmp_path / "export/only_object-box"  # as `rpl export --object box` writes it
    shutil.copytree(coco, chosen / "coco")
    shutil.copytree(tmp_path / "export/yolo", chosen / "yolo")
    (tmp_path / "export/other").mkdir()
    capsys.readouterr()
    assert main(["check", str(tmp_path / "export")]) == 0
    said = capsys.readouterr().out
    assert f"{chosen}/yolo: yolo: no fault" in said and f"{chosen}/coco: coco: no fault" in said
    assert f"{tmp_path}/export/other: not checked" in said
    mask = next((tmp_path / "export/bop").rglob("mask_visib/*.png"))
    cv2.imwrite(str(mask), np.zeros_like(cv2.imread(str(mask), -1)))
    capsys.readouterr()
    assert main(["check", str(tmp_path / "export/bop")]) == 1
    said = capsys.readouterr()
    assert "scene_gt_info.json: image " in said.out and "px_count_visib: expected 0" in said.out
    assert re.search(r"\d faults in .*bop; undo what was changed", said.err)


def test_several_instances_and_a_single_split_give_no_alarm(tmp_path: Path) -> None:
    """LINEMOD has an image once per instance; YCB-Video leaves it out, and lists no empty ones."""
    recording, units = tmp_path / "recording", {"a": 0.001, "b": 0.0002}
    made = [two_boxes(recording, "a"), labelled_scene(recording, "b", frames=3, suffix=".jpg")]
    plain = replace(CAMERA, distortion=())
    scenes = [
        replace(item, scene=replace(item.scene, intrinsics=plain, metres_per_unit=units[item.scene.name]))
        for item in made
    ]
    export_coco(tmp_path / "coco", scenes, [BOX, CAN], split=SplitRule(0, 0.0))
    for write in (export_linemod, export_ycb_video):
        write(tmp_path / write.__name__, tmp_path / "coco", units)
        assert dialect_of(tmp_path / write.__name__) == write.__name__.removeprefix("export_")
        assert check_export(tmp_path / write.__name__) == []
    assert not (tmp_path / "export_ycb_video/image_sets/test.txt").exists()


def test_the_dataset_itself_is_no_export(tmp_path: Path) -> None:
    make_sequence(tmp_path / "data/0048", 1)
    assert dialect_of(tmp_path) is None


def test_polygons_of_another_program_are_no_fault_unless_they_are_damaged(
    exports: Path, tmp_path: Path
) -> None:
    shutil.copytree(exports / "coco", tmp_path / "coco")
    train = tmp_path / "coco/train.json"
    data = json.loads(train.read_text())
    left, top, width, height = data["annotations"][0]["bbox"]
    corners = [left, top, left + width, top, left + width, top + height, left, top + height]
    for polygon, said in ((corners, []), (corners[:4], ["segmentation"])):
        data["annotations"][0]["segmentation"] = [polygon]
        train.write_text(json.dumps(data))
        faults = [fault for fault in check_export(tmp_path / "coco") if "SHA256SUMS" not in fault.problem]
        assert [fault.field for fault in faults] == said
    del data["annotations"][0]["id"]
    train.write_text(json.dumps(data))
    assert any("lacks 'id'" in fault.problem for fault in check_export(tmp_path / "coco"))


def test_what_contradicts_the_masks_is_named(exports: Path, tmp_path: Path) -> None:
    """A box that misses what is seen, an object listed twice, and a frame in two lists."""
    shutil.copytree(exports / "ycb_video", tmp_path / "ycb")
    stem = tmp_path / "ycb/data/0000/000002"
    boxes = Path(f"{stem}-box.txt")
    first, *others = boxes.read_text().splitlines()
    name, left, *rest = first.split()
    boxes.write_text("\n".join([f"{name} {float(left) + 5} {' '.join(rest)}", *others]))
    label = cv2.imread(f"{stem}-label.png", -1)
    label[0, 0] = 9
    cv2.imwrite(f"{stem}-label.png", label)
    (tmp_path / "ycb/image_sets/val.txt").write_text("0000/000002\n0000/000001\n")
    said = [str(fault) for fault in check_export(tmp_path / "ycb")]
    assert [fault.split(";")[0].split(" around")[0] for fault in said] == [
        "data/0000/000002-label.png: numbers: expected 0 and those of cls_indexes, [1, 2]",
        f"data/0000/000002-box.txt: {name}: box: expected a box of the image",
        "image_sets/val.txt: line 1: image: 0000/000002 is listed twice",
        "image_sets/val.txt: line 2: image: expected a frame with an object, such as 0000/000001, "
        "found '0000/000001'",
    ]
    shutil.copytree(exports / "linemod", tmp_path / "lm")
    truth = tmp_path / "lm/data/01/gt.yml"
    entries = yaml.safe_load(truth.read_text())
    entries[0][0]["obj_bb"][0] += 40
    truth.write_text(yaml.safe_dump(entries))
    (fault,) = check_export(tmp_path / "lm")
    assert (fault.file, fault.record, fault.field) == ("data/01/gt.yml", "image 0", "obj_bb")


def test_folders_of_what_others_check_already(exports: Path, tmp_path: Path) -> None:
    """One COCO folder per object, and BOP's scenes as onboarding videos."""
    shutil.copytree(exports / "coco", tmp_path / "each/box")
    shutil.copytree(exports / "bop/train/000001", tmp_path / "videos/onboarding_static/obj_000001_up")
    described = {"obj_000001_up": {"object": "box", "scene": "a"}}
    (tmp_path / "videos/names.json").write_text(json.dumps(described))
    known = {"each": "coco_per_object", "videos": "bop_onboarding"}
    for name, dialect in known.items():
        assert dialect_of(tmp_path / name) == dialect and check_export(tmp_path / name) == []
    (tmp_path / "each/box/images/a/000001.png").unlink()
    next((tmp_path / "videos/onboarding_static/obj_000001_up/mask").iterdir()).unlink()
    (tmp_path / "videos/names.json").write_text("{}")
    said = [str(fault) for name in known for fault in check_export(tmp_path / name)]
    assert [fault.split(": ")[0] for fault in said] == [
        "box/train.json",
        "names.json",
        "onboarding_static/obj_000001_up/mask/000001_000000.png",
    ]


def test_names_without_numbers_are_faults(exports: Path, tmp_path: Path) -> None:
    shutil.copytree(exports / "bop", tmp_path / "bop")
    shutil.copy(tmp_path / "bop/models/obj_000001.ply", tmp_path / "bop/models/mug.ply")
    shutil.copytree(tmp_path / "bop/train/000001", tmp_path / "bop/test/000001_old")
    said = [str(fault) for fault in check_export(tmp_path / "bop", "bop")]
    assert any("models/mug.ply" in fault for fault in said)


def test_what_is_no_export_is_refused_or_left_to_the_doctor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dialect_of(tmp_path) is None
    assert main(["check", str(tmp_path), "--export", "kitti"]) == 1
    assert "unknown export 'kitti'; expected one of coco, yolo" in capsys.readouterr().err
    assert main(["check", str(tmp_path)]) == 1
    assert "looks like no format that is known" in capsys.readouterr().err
