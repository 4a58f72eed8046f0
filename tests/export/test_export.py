"""Export: files, links, splits, replacement as a whole, and how near test views are to training's."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from labelled_scenes import BOX, CAN, instance, labelled_scene
from PIL import Image, ImageOps

from rpl_data.export import ExportScene, export_coco, export_huggingface, export_yolo
from rpl_data.export.folder import Filling, link
from rpl_data.export.split import SplitRule, choose_splits
from rpl_data.export.view_distances import ViewDirection, view_direction, view_distances
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.geometry import from_rotvec, invert
from rpl_data.types import DataError, DepthCoding, FrameLabel

SPLITS = ("train", "val", "test")


def scenes(folder, count, **options):
    return [labelled_scene(folder, f"s{n}", seed=n, **options) for n in range(count)]


def frames_of(folder):
    found = {}
    for name in SPLITS:
        if (folder / f"{name}.json").exists():
            data = read_coco(folder / f"{name}.json")
            found |= {(image["scene"], image["frame"]): (name, image["id"]) for image in data["images"]}
    return found


def test_folder_is_complete(tmp_path):
    mesh = tmp_path / "mesh.ply"
    mesh.write_text("ply")
    exports = scenes(tmp_path / "recording", 4)
    summary = export_coco(
        tmp_path / "coco", exports, [BOX, CAN], split=SplitRule(val_fraction=0.2), meshes={"box": mesh}
    )
    data = {name: read_coco(tmp_path / "coco" / f"{name}.json") for name in SPLITS}
    assert summary.images == {name: len(d["images"]) for name, d in data.items()}
    assert sum(summary.images.values()) == 24  # frames without instances are images too
    for name, d in data.items():
        categories = {c["id"]: c["name"] for c in d["categories"]}
        for number, model in categories.items():
            found = sum(a["category_id"] == number for a in d["annotations"])
            assert summary.instances[name][model] == found
        for image in d["images"]:
            color, depth = (tmp_path / "coco" / image[key] for key in ("file_name", "depth_file_name"))
            source = tmp_path / "recording" / image["scene"] / f"c{image['frame']}.png"
            assert color.read_bytes() == source.read_bytes()
            assert depth.read_bytes() == source.with_name(f"d{image['frame']}.png").read_bytes()
    assert data["train"]["rpl"]["objects"][0]["mesh"] == "meshes/box.ply"
    assert (tmp_path / "coco" / "meshes" / "box.ply").read_text() == "ply"
    ids = [a["id"] for d in data.values() for a in d["annotations"]]
    assert len(set(ids)) == len(ids) == 40
    assert len(summary.scenes["test"]) == 1 and not set(summary.scenes["test"]) & set(summary.scenes["train"])
    assert sum(summary.links.values()) == 49 and summary.links.keys() <= {"clone", "copy"}
    assert summary.invisible == 0 and summary.messages == ()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["coco", "mesh.ply", "recording"]


def test_same_seed_same_split_other_seed_other_split(tmp_path):
    exports = scenes(tmp_path / "recording", 5)
    found = []
    for seed in (1, 1, 2, 3):
        export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule(val_fraction=0.3, seed=seed))
        found.append(frames_of(tmp_path / "coco"))
    assert found[0] == found[1]
    assert found[0] != found[2] or found[0] != found[3]


def test_labels_are_read_once_and_may_be_an_iterator(tmp_path):
    exports = [ExportScene(e.scene, e.trajectory, iter(e.labels)) for e in scenes(tmp_path / "recording", 3)]
    summary = export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule())
    assert sum(summary.images.values()) == 18


def test_truth_keeps_split_and_ids(tmp_path):
    exports = scenes(tmp_path / "recording", 3)
    export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule(seed=4, val_fraction=0.4))
    truth = [ExportScene(e.scene, e.trajectory, e.labels[::-1]) for e in exports[::-1]]
    export_coco(tmp_path / "truth", truth, [BOX, CAN], split=SplitRule(), as_in=tmp_path / "coco")
    assert frames_of(tmp_path / "truth") == frames_of(tmp_path / "coco")


def test_old_export_stays_when_the_new_one_fails(tmp_path):
    exports = scenes(tmp_path / "recording", 3)
    export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule())
    before = frames_of(tmp_path / "coco")
    Path(exports[2].scene.frames[4].color).unlink()
    with pytest.raises(DataError, match=r"c4\.png is missing"):
        export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule(seed=9))
    assert frames_of(tmp_path / "coco") == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["coco", "recording"]


def test_output_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match="cannot write"):
        export_coco(tmp_path / "file" / "coco", scenes(tmp_path / "r", 1), [BOX, CAN], split=SplitRule())
    assert (tmp_path / "file").read_text() == "in the way"


def test_split_files_have_no_nan(tmp_path):
    export_coco(tmp_path / "coco", scenes(tmp_path / "r", 1), [BOX, CAN], split=SplitRule())
    text = (tmp_path / "coco" / "train.json").read_text()
    assert "NaN" not in text and json.loads(text)


def test_messages_of_bad_labels(tmp_path):
    (scene,) = scenes(tmp_path / "r", 1)
    with pytest.raises(DataError, match="unknown object 'can'"):
        export_coco(tmp_path / "coco", [scene], [BOX], split=SplitRule())
    stray = FrameLabel("s0", 77, 0.0, ())
    with pytest.raises(DataError, match="frame 77"):
        export_coco(
            tmp_path / "coco", [ExportScene(scene.scene, scene.trajectory, [stray])], [BOX], split=SplitRule()
        )
    with pytest.raises(DataError, match="no labelled frame"):
        export_coco(
            tmp_path / "coco", [ExportScene(scene.scene, scene.trajectory, [])], [BOX], split=SplitRule()
        )
    assert not (tmp_path / "coco").exists()


def test_invisible_instances_are_counted(tmp_path):
    (scene,) = scenes(tmp_path / "r", 1, objects=(BOX,))
    hidden = [FrameLabel("s0", n, n / 30, (instance(BOX, 0.0, visible=False),)) for n in range(6)]
    export = ExportScene(scene.scene, scene.trajectory, hidden)
    summary = export_coco(tmp_path / "coco", [export], [BOX], split=SplitRule())
    assert summary.invisible == 6 and summary.instances["train"] == {"box": 0} and summary.views == {}


# The split rule -----------------------------------------------------------------------------------


def frames(**objects):
    """Ten frames a scene, the objects in each given as a string of one-letter names."""
    return {(scene, n): frozenset(names) for scene, names in objects.items() for n in range(10)}


def test_every_object_gets_a_test_scene():
    taken = frames(s1="a", s2="a", s3="b", s4="b", s5="a")
    for seed in range(20):
        splits, messages = choose_splits(taken, SplitRule(seed=seed))
        test = {scene for (scene, _), name in splits.items() if name == "test"}
        assert len(test) == 2 and {"s3", "s4"} & test and {"s1", "s2", "s5"} & test and messages == ()
        assert sum(name == "val" for name in splits.values()) == 3  # a tenth of the other 30
        by_scene = {scene: {splits[scene, n] for n in range(10)} for scene in test}
        assert all(found == {"test"} for found in by_scene.values())


def test_one_scene_with_all_objects_is_enough():
    for seed in range(10):
        splits, _ = choose_splits(frames(s1="a", s2="ab", s3="b", s4="ab"), SplitRule(seed=seed))
        test = {scene for (scene, _), name in splits.items() if name == "test"}
        assert test in ({"s2"}, {"s4"})


def test_an_object_never_loses_its_only_scene():
    splits, messages = choose_splits(frames(s1="a", s2="a", s3="ab"), SplitRule())
    assert splits["s3", 0] != "test" and "no test scene for b" in messages[0]


def test_fewer_than_three_scenes_have_no_test_split():
    splits, messages = choose_splits(frames(s1="a", s2="a"), SplitRule())
    assert set(splits.values()) == {"train", "val"} and "no test split" in messages[0]


def test_named_test_scenes():
    splits, _ = choose_splits(frames(s1="a", s2="a", s3="a"), SplitRule(test_scenes=("s2",)))
    assert {scene for (scene, _), name in splits.items() if name == "test"} == {"s2"}
    with pytest.raises(DataError, match="s9"):
        choose_splits(frames(s1="a"), SplitRule(test_scenes=("s9",)))
    with pytest.raises(DataError, match="val_fraction"):
        choose_splits(frames(s1="a"), SplitRule(val_fraction=1.5))
    with pytest.raises(DataError, match="seed must be 0 or more, got -1"):
        choose_splits(frames(s1="a"), SplitRule(seed=-1))


# Views --------------------------------------------------------------------------------------------


def test_view_does_not_depend_on_the_roll_of_the_camera():
    label = instance(BOX, 0.1)
    rolled = from_rotvec(np.array([0, 0, 0.7]), np.zeros(3)) @ label.camera_from_object
    view = view_direction(("s", 0), 0.0, label)
    again = view_direction(("s", 0), 0.0, type(label)(**label.__dict__ | {"camera_from_object": rolled}))
    np.testing.assert_allclose(view.direction_object, again.direction_object)
    camera = invert(label.camera_from_object)[:3, 3]
    np.testing.assert_allclose(view.direction_object * np.linalg.norm(camera), camera)


def test_distances_worked_by_hand():
    def view(scene, frame, degrees):
        angle = np.deg2rad(degrees)
        return ViewDirection("a", (scene, frame), frame / 10, np.array([np.cos(angle), np.sin(angle), 0]))

    views = [view("s", 0, 0), view("s", 5, 50), view("s", 1, 10), view("s", 4, 30), view("t", 0, 80)]
    splits = {("s", 0): "train", ("s", 5): "train", ("s", 1): "val", ("s", 4): "val", ("t", 0): "test"}
    distances = view_distances(views, splits)
    val, test = distances["val"], distances["test"]
    assert (
        val.views == 2
        and val.angle_median_deg == pytest.approx(15)
        and val.angle_p90_deg == pytest.approx(19)
    )
    assert val.time_median_s == pytest.approx(0.1)
    assert test.angle_median_deg == pytest.approx(30) and test.time_median_s is None


def test_an_image_that_asks_to_be_turned_is_exported_without_its_tag(tmp_path):
    """The tag says "turn me"; every reader of the export then sees the pixels that were labelled."""
    (one,) = scenes(tmp_path / "recording", 1)
    sources = sorted((tmp_path / "recording" / "s0").glob("c*.png"))
    pixels = [np.asarray(Image.open(path)).copy() for path in sources]
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(pixels[2]).save(sources[2], exif=exif)
    export_coco(tmp_path / "coco", [one], [BOX, CAN], split=SplitRule())
    exported = sorted((tmp_path / "coco" / "images" / "s0").glob("*.png"))
    for path, stored in zip(exported, pixels, strict=True):
        np.testing.assert_array_equal(ImageOps.exif_transpose(Image.open(path)), stored)
    same = [a.read_bytes() == b.read_bytes() for a, b in zip(exported, sources, strict=True)]
    assert same.count(False) == 1


def test_depth_that_is_mended_while_it_is_read_is_exported_mended(tmp_path):
    (one,) = scenes(tmp_path / "recording", 1)
    stored = [cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED) for frame in one.scene.frames]
    for frame, units in zip(one.scene.frames, stored, strict=True):
        cv2.imwrite(str(frame.depth), (units << 3) | (units >> 13))
    turned = replace(one, scene=replace(one.scene, depth_coding=DepthCoding(bits_turned=True)))
    export_coco(tmp_path / "coco", [turned], [BOX, CAN], split=SplitRule())
    exported = sorted((tmp_path / "coco" / "depth" / "s0").glob("*.png"))
    for path, units in zip(exported, stored, strict=True):
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), units)


def test_numbers_that_mean_no_depth_are_exported_as_none(tmp_path):
    """Other readers know 0 only: 65535 would be a wall at 65 m."""
    (one,) = scenes(tmp_path / "recording", 1)
    marked = one.scene.frames[1]
    units = cv2.imread(str(marked.depth), cv2.IMREAD_UNCHANGED)
    units[:3] = 65535
    cv2.imwrite(str(marked.depth), units)
    one = replace(one, scene=replace(one.scene, no_depth_units=(65535,)))
    export_coco(tmp_path / "coco", [one], [BOX, CAN], split=SplitRule())
    exported = sorted((tmp_path / "coco" / "depth" / "s0").glob("*.png"))
    sources = [frame.depth.read_bytes() for frame in one.scene.frames]
    same = [path.read_bytes() == source for path, source in zip(exported, sources, strict=True)]
    assert same.count(False) == 1 and not same[1]
    found = cv2.imread(str(exported[1]), cv2.IMREAD_UNCHANGED)
    assert not found[:3].any() and (found[3:] == units[3:]).all()


# Writing into an export ---------------------------------------------------------------------------


def _spoil(folder):
    """Write four bytes into every file of a folder, in place, as a program that edits images may do."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("r+b") as file:
                file.write(b"\x00\x01\x02\x03")


@pytest.mark.parametrize("dialect", [None, export_yolo, export_huggingface])
def test_what_is_written_into_an_export_never_reaches_the_recording(tmp_path, dialect):
    exports = scenes(tmp_path / "recording", 1)
    before = {path: path.read_bytes() for path in (tmp_path / "recording").rglob("*.png")}
    export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule())
    export_coco(tmp_path / "truth", exports, [BOX, CAN], split=SplitRule(), as_in=tmp_path / "coco")
    if dialect is not None:
        dialect(tmp_path / "dialect", tmp_path / "coco")
        _spoil(tmp_path / "dialect")
    _spoil(tmp_path / "truth")
    _spoil(tmp_path / "coco")
    assert before and before == {path: path.read_bytes() for path in before}


def test_links_to_the_recording_are_made_on_request_and_said(tmp_path):
    exports = scenes(tmp_path / "recording", 1)
    summary = export_coco(tmp_path / "coco", exports, [BOX, CAN], split=SplitRule(), images="link")
    if "clone" not in summary.links:  # the file system has no clones, which would be neither link nor risk
        assert summary.links == {"hard link": 12}
        assert summary.messages[-1].startswith("12 files of the export are links to the recording")
        images = sorted((tmp_path / "coco/images/s0").iterdir())
        assert images[0].samefile(exports[0].scene.frames[0].color)


def test_two_images_of_one_name_are_refused_not_written_into_each_other(tmp_path):
    source, target = tmp_path / "source", tmp_path / "target"
    source.write_text("recording")
    link(source, target)
    with pytest.raises(FileExistsError):
        link(tmp_path / "source", target)
    with pytest.raises(FileExistsError):
        Filling().put(tmp_path / "source", target)
    assert source.read_text() == "recording"
