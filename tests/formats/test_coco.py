"""Our dialect of COCO: every field, the round trip, what is refused, and pycocotools as outside judge."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from labelled_scenes import BOX, CAMERA, CAN, instance, rle
from pycocotools import mask as masks
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from rpl_data.formats.datasets import coco_check, coco_parts
from rpl_data.formats.datasets.coco import (
    CocoObject,
    header,
    image_to_coco,
    instance_to_coco,
    intrinsics_from_coco,
    labels_from_coco,
    objects_from_coco,
    read_coco,
    validate_coco,
    write_coco,
    writing_coco,
)
from rpl_data.formats.datasets.coco_batch import sound_annotations, sound_images
from rpl_data.formats.datasets.coco_parts import ByImage, read_packed
from rpl_data.geometry import from_rotvec
from rpl_data.types import DataError, Frame, FrameLabel, InstanceLabel, Symmetries, SymmetryAxis

OBJECTS = (CocoObject(BOX, "meshes/box.ply"), CocoObject(CAN))
LABELS = (
    FrameLabel("desk", 3, 0.1, (instance(BOX, -0.2), instance(CAN, 0.2))),
    FrameLabel("desk", 5, 0.2, ()),
    FrameLabel("shelf", 3, 0.3, (instance(CAN, 0.1),)),
)


def entries(label, image_id, first_id=1):
    frame = Frame(label.frame, label.timestamp_s, Path("c.png"), Path("d.png"))
    image = image_to_coco(
        image_id,
        frame,
        scene=label.scene,
        intrinsics=CAMERA,
        scene_from_camera=from_rotvec(np.array([0, 0.1, 0]), np.array([0.1, 0.2, 0.3])),
        file_name=f"images/{label.scene}/{label.frame:06d}.png",
        depth_file_name=None,
    )
    numbers = {"box": 1, "can": 2}
    annotations = [
        instance_to_coco(first_id + row, image_id, numbers[item.object], item)
        for row, item in enumerate(label.instances)
    ]
    return image, annotations


@pytest.fixture
def data():
    content = header(OBJECTS) | {"images": [], "annotations": []}
    for number, label in enumerate(LABELS, start=1):
        image, annotations = entries(label, number, 1 + len(content["annotations"]))
        content["images"].append(image)
        content["annotations"] += annotations
    return content


def test_every_field_of_the_design_is_there(data):
    image, annotation = data["images"][0], data["annotations"][0]
    assert image["scene"] == "desk" and image["frame"] == 3 and image["timestamp_s"] == 0.1
    assert image["cam_K"] == [150.0, 0.0, 79.5, 0.0, 151.0, 59.5, 0.0, 0.0, 1.0]
    assert image["distortion"] == [0.01, -0.02, 0.0, 0.0]
    assert len(image["scene_from_camera"]) == 16 and image["scene_from_camera"][3] == 0.1
    assert image["depth_file_name"] is None and image["width"] == 160 and image["height"] == 120
    label = LABELS[0].instances[0]
    assert annotation["camera_from_object"] == label.camera_from_object.ravel().tolist()
    assert annotation["keypoints"][9:] == [0, 0, 0] and annotation["keypoints"][2::3] == [1, 2, 2, 0]
    np.testing.assert_allclose(annotation["keypoints"][:2], label.keypoints_px[0], atol=1e-4)
    assert annotation["num_keypoints"] == 3 and annotation["iscrowd"] == 0
    assert annotation["sigma_px"] == [0.5, 0.5, 0.5, None]
    x0, y0, x1, y1 = label.box
    assert annotation["bbox"] == [x0, y0, x1 - x0, y1 - y0]
    assert annotation["area"] == (x1 - x0) * (y1 - y0)
    x0, y0, x1, y1 = label.box_full
    assert annotation["bbox_full"] == [x0, y0, x1 - x0, y1 - y0]
    assert annotation["segmentation_full"] == label.mask_full and annotation["segmentation"] == label.mask
    assert annotation["visib_fract"] == label.visib_fract and annotation["truncated"] is False
    assert annotation["quality"] == 0.75
    box = label.square_box
    assert annotation["square_box"] == [box.cx_px, box.cy_px, box.side_px]
    assert [c["id"] for c in data["categories"]] == [1, 2]
    assert data["categories"][0]["keypoints"] == ["a", "b", "c", "d"]
    assert data["categories"][0]["skeleton"] == [[1, 2], [2, 3]]
    first = data["rpl"]["objects"][0]
    assert first["name"] == "box" and first["category_id"] == 1 and first["mesh"] == "meshes/box.ply"
    assert first["points_object"][1] == [0.1, -0.1, 0.0] and first["points_object"][3] is None
    assert first["symmetries"] == [] and data["rpl"]["version"]


def test_one_visible_pixel_has_a_box_of_one(data):
    mask = np.zeros((120, 160), dtype=bool)
    mask[7, 5] = True
    label = instance(BOX, 0.0)
    one = InstanceLabel(**{**label.__dict__, "mask": rle(mask), "box": (5.0, 7.0, 6.0, 8.0)})
    entry = instance_to_coco(1, 1, 1, one)
    assert entry["bbox"] == [5, 7, 1, 1] and entry["area"] == 1


def test_invisible_instance_is_no_annotation():
    assert instance_to_coco(1, 1, 1, instance(BOX, 0.0, visible=False)) is None


def test_labels_come_back(data):
    for label, back in zip(LABELS, labels_from_coco(json.loads(json.dumps(data))), strict=True):
        assert (back.scene, back.frame, back.timestamp_s) == (label.scene, label.frame, label.timestamp_s)
        for a, b in zip(label.instances, back.instances, strict=True):
            labelled = a.visibility > 0
            np.testing.assert_allclose(b.keypoints_px[labelled], a.keypoints_px[labelled], atol=1e-4)
            assert np.isnan(b.keypoints_px[~labelled]).all()
            np.testing.assert_array_equal(b.camera_from_object, a.camera_from_object)
            np.testing.assert_array_equal(b.visibility, a.visibility)
            for name in ("object", "box", "box_full", "mask", "mask_full", "visib_fract", "square_box"):
                assert getattr(a, name) == getattr(b, name), name
    models = [item.model for item in objects_from_coco(data)]
    np.testing.assert_array_equal(models[0].points_object, BOX.points_object)
    assert models[0].skeleton == BOX.skeleton and models[0].keypoints == BOX.keypoints
    assert intrinsics_from_coco(data["images"][0]) == CAMERA


def test_streamed_file_equals_the_one_from_memory(data, tmp_path):
    with writing_coco(tmp_path / "streamed.json", OBJECTS) as writer:
        first = 1
        for number, label in enumerate(LABELS, start=1):
            image, annotations = entries(label, number, first)
            writer.add(image, annotations)
            first += len(annotations)
        assert list(tmp_path.iterdir()) == []  # nothing half-written to be seen
    write_coco(tmp_path / "memory.json", data)
    assert read_coco(tmp_path / "streamed.json") == read_coco(tmp_path / "memory.json") == data


def test_file_without_images_is_valid(tmp_path):
    with writing_coco(tmp_path / "empty.json", OBJECTS):
        pass
    assert read_coco(tmp_path / "empty.json")["images"] == []


def wrong(data, change):
    """The message about `data` after `change`."""
    broken = deepcopy(data)
    change(broken)
    with pytest.raises(DataError) as error:
        validate_coco(broken, source="train.json")
    assert "train.json" in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("rpl"), "rpl missing"),
        (lambda d: d["annotations"][0].pop("square_box"), "square_box missing"),
        (lambda d: d["annotations"][0].update(image_id=99), "image 99"),
        (lambda d: d["annotations"][1].update(id=1), "a unique whole number as id"),
        (lambda d: d["annotations"][0].update(area=3), "area"),
        (lambda d: d["annotations"][0].update(bbox=[0, 0, 3, 3]), "bbox"),
        (lambda d: d["annotations"][0]["keypoints"].pop(), "12 numbers"),
        (lambda d: d["annotations"][0].update(num_keypoints=4), "num_keypoints"),
        (lambda d: d["annotations"][0]["keypoints"].__setitem__(9, 4.0), "v = 0"),
        (lambda d: d["annotations"][0].update(visib_fract=1.5), "0 to 1"),
        (lambda d: d["annotations"][0].update(square_box=[9.0, 9.0, 0.0]), "a side above 0"),
        (lambda d: d["annotations"][0]["camera_from_object"].__setitem__(0, 3.0), "rigid"),
        (lambda d: d["annotations"][0]["keypoints"].__setitem__(0, float("nan")), "finite"),
        (lambda d: d["annotations"][0]["segmentation"].update(size=[5, 5]), r"size [120, 160]"),
        (lambda d: d["categories"][0].update(id=0), "ids from 1"),
        (lambda d: d["categories"][0].update(skeleton=[[0, 1]]), "skeleton"),
        (lambda d: d["rpl"]["objects"][0]["points_object"].pop(), "one per keypoint"),
        (lambda d: d["images"][0].update(cam_K=[1.0]), "9 numbers"),
        (lambda d: d.update(images={}), "a list"),
        (lambda d: d["images"][0].update(distortion=[0.0] * 15), "at most 14 numbers"),
        (lambda d: d["images"][0].update(width="160"), "not a whole number"),
        (lambda d: d["annotations"][0]["segmentation"].update(counts="o0" * 9), "annotation 1: segmentation"),
        (lambda d: d["annotations"][0].update(sigma_px=["x"] * 4), "sigma_px"),
        (lambda d: d["annotations"][0].update(visib_fract=None), "visib_fract"),
        (lambda d: d["categories"][0].update(skeleton=[[1, 2, 3]]), "skeleton"),
        (lambda d: d["rpl"].update(objects=None), "a list"),
    ],
)
def test_what_is_refused(data, change, message, monkeypatch):
    assert message in wrong(data, change)
    monkeypatch.setattr(coco_check, "FEWEST_IN_BATCH", 1)  # all of them are first looked at together
    assert message in wrong(data, change)


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.pop("quality"),
        lambda a: a.update(truncated=0),
        lambda a: a.update(instance=2),
        lambda a: a.update(category_id=3),
        lambda a: a.update(area=True),
        lambda a: a.update(area=float(a["area"])),
        lambda a: a.update(bbox_full=[0, 0, 3, 3]),
        lambda a: a.update(square_box=(1.0, 2.0, 3.0)),
        lambda a: a["sigma_px"].append(0.5),
        lambda a: a["keypoints"].__setitem__(2, 3),
        lambda a: a["camera_from_object"].__setitem__(12, 0.1),
        lambda a: a["camera_from_object"].__setitem__(0, "1"),
        lambda a: a["segmentation_full"].update(size=[120.0, 160.0]),
        lambda a: a.update(segmentation=None),
    ],
)
def test_many_entries_are_checked_at_once(data, change):
    images = {image["id"]: image for image in data["images"]}
    categories = {category["id"]: category for category in data["categories"]}
    limits = {"skew": coco_check.SKEW, "box_px": coco_check.BOX_PX}
    assert sound_images(data["images"], skew=coco_check.SKEW, longest_distortion=14)
    assert sound_annotations(data["annotations"], images, categories, **limits)
    change(data["annotations"][1])
    assert not sound_annotations(data["annotations"], images, categories, **limits)


def test_a_packed_file_is_the_same_dataset(data, tmp_path, monkeypatch):
    monkeypatch.setattr(coco_parts, "BATCH", 2)
    with writing_coco(tmp_path / "lines.json", OBJECTS) as writer:
        first = 1
        for number, label in enumerate(LABELS, start=1):
            image, annotations = entries(label, number, first)
            writer.add(image, annotations)
            first += len(annotations)
    write_coco(tmp_path / "one_line.json", data)
    for name in ("lines.json", "one_line.json"):
        packed = read_packed(tmp_path / name, {"images": ("id", "scene")})
        assert list(packed["annotations"]) == packed["annotations"][:] == data["annotations"]
        assert packed["annotations"][-1] == data["annotations"][-1]
        assert packed["images"][1] == {"id": 2, "scene": "desk"} and len(packed["images"]) == 3
        with pytest.raises(IndexError):
            packed["images"][3]
        by_image: dict[int, list] = {}
        for annotation in data["annotations"]:
            by_image.setdefault(annotation["image_id"], []).append(annotation)
        assert dict(ByImage(packed["annotations"])) == by_image
        doubled = ByImage(packed["annotations"], data["annotations"])
        assert dict(doubled) == {key: own + own for key, own in by_image.items()} and 99 not in doubled
    text = (tmp_path / "lines.json").read_text()
    (tmp_path / "damaged.json").write_text(text.replace('"truncated": false', '"truncated": 5'))
    with pytest.raises(DataError, match="annotation 1: truncated: 5 is neither true nor false"):
        read_packed(tmp_path / "damaged.json", {})
    (tmp_path / "cut.json").write_text(text[:-200])
    with pytest.raises(DataError, match="not valid JSON"):
        read_packed(tmp_path / "cut.json", {})
    data["annotations"][0]["note"] = "\ud800"
    (tmp_path / "half.json").write_text(json.dumps(data))
    with pytest.raises(DataError, match="half.json"):
        read_packed(tmp_path / "half.json")


def edited(data, tmp_path, change):
    """`data` after a change by another program, as it is read."""
    content = deepcopy(data)
    change(content)
    (tmp_path / "train.json").write_text(json.dumps(content))
    return read_coco(tmp_path / "train.json")


def as_text_ids(content):
    for entry in (*content["images"], *content["annotations"], *content["categories"]):
        for key in {"id", "image_id", "category_id"} & entry.keys():
            entry[key] = str(entry[key])


def as_plain_runs(content):
    for annotation in content["annotations"]:
        for key in ("segmentation", "segmentation_full"):
            columns = masks.decode(annotation[key]).ravel("F").astype(int)
            ends = [0, *(np.flatnonzero(np.diff(columns)) + 1), len(columns)]
            runs = np.diff(ends).tolist()
            annotation[key]["counts"] = [0, *runs] if columns[0] else runs


def as_polygons(content):
    for annotation in content["annotations"]:
        for key, box in (("segmentation", "bbox"), ("segmentation_full", "bbox_full")):
            x, y, w, h = annotation[box]
            annotation[key] = [[x, y, x + w, y, x + w, y + h, x, y + h]]


def with_more_keys(content):
    content["annotations"][0]["attributes"] = {"checked": True}
    content["licenses"] = None


@pytest.mark.parametrize("change", [as_text_ids, as_plain_runs, as_polygons, with_more_keys])
def test_what_other_programs_write_is_the_same_dataset(data, tmp_path, change):
    for one, other in zip(
        labels_from_coco(edited(data, tmp_path, change)), labels_from_coco(data), strict=True
    ):
        assert (one.scene, one.frame) == (other.scene, other.frame)
        for a, b in zip(one.instances, other.instances, strict=True):
            assert (a.object, a.mask, a.mask_full, a.box, a.box_full) == (
                b.object,
                b.mask,
                b.mask_full,
                b.box,
                b.box_full,
            )
            assert a.visib_fract == pytest.approx(b.visib_fract)


def test_a_mask_drawn_larger_than_the_object_makes_it_larger(data, tmp_path):
    corners = [10.0, 20.0, 60.0, 20.0, 60.0, 60.0, 10.0, 60.0]
    entry = edited(data, tmp_path, lambda d: d["annotations"][0].update(segmentation=[corners]))
    entry = entry["annotations"][0]
    assert entry["area"] == 50 * 40 and entry["bbox"] == [10, 20, 50, 40]
    full = masks.decode(entry["segmentation_full"])
    assert full[20:60, 10:60].all() and entry["visib_fract"] == pytest.approx(2000 / full.sum())


def test_a_crowd_is_no_instance(data, tmp_path):
    def crowd(content):
        seen = content["annotations"][0]["segmentation"]
        content["annotations"].append(
            {"id": 9, "image_id": 1, "category_id": 1, "iscrowd": 1, "segmentation": seen}
        )

    back = edited(data, tmp_path, crowd)
    assert back["annotations"] == data["annotations"]
    assert back["crowds"][0]["area"] == data["annotations"][0]["area"]
    assert labels_from_coco(back)[0].instances[0].object == "box"


@pytest.mark.parametrize("written", [0, False, 0.0, "0", "false"])
def test_no_crowd_is_no_crowd_however_it_is_written(data, tmp_path, written):
    back = edited(data, tmp_path, lambda content: content["annotations"][0].update(iscrowd=written))
    assert back["annotations"] == data["annotations"] and "crowds" not in back
    with pytest.raises(DataError, match="iscrowd is 'maybe'; expected 0 or 1"):
        edited(data, tmp_path, lambda content: content["annotations"][0].update(iscrowd="maybe"))


@pytest.mark.parametrize(
    "segmentation",
    [
        [[0, 0, 1e308, 0, 5, 5]],
        [[0, 0, 5, 5]],
        [],
        [["a"] * 6],
        {"size": [120, 160], "counts": [-5, 19205]},
        {"size": [120, 160], "counts": [7]},
        "mask",
        None,
    ],
)
def test_masks_that_are_none_are_refused(data, tmp_path, segmentation):
    with pytest.raises(DataError, match="annotation 1"):
        edited(data, tmp_path, lambda d: d["annotations"][0].update(segmentation=segmentation))


def test_broken_file_is_named(tmp_path):
    (tmp_path / "train.json").write_text("{")
    with pytest.raises(DataError, match=r"train\.json"):
        read_coco(tmp_path / "train.json")
    with pytest.raises(DataError, match="does not exist"):
        read_coco(tmp_path / "val.json")


@pytest.mark.parametrize("kind", ["bbox", "segm", "keypoints"])
def test_scores_one_against_itself(data, tmp_path, kind, capsys):
    write_coco(tmp_path / "train.json", data)
    truth = COCO(str(tmp_path / "train.json"))
    keys = ("image_id", "category_id", "bbox", "segmentation", "keypoints")
    found = truth.loadRes([{key: a[key] for key in keys} | {"score": 0.9} for a in data["annotations"]])
    for category in data["categories"]:
        evaluation = COCOeval(truth, found, kind)
        evaluation.params.catIds = [category["id"]]
        evaluation.params.kpt_oks_sigmas = np.full(len(category["keypoints"]), 0.05)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
        assert evaluation.stats[0] == pytest.approx(1.0, abs=1e-9)


def test_symmetries_come_back_and_an_axis_without_direction_is_named(data):
    half_turn = tuple(np.diag([-1.0, 1.0, -1.0, 1.0]).ravel().tolist())
    item = CocoObject(
        BOX, symmetries=Symmetries((half_turn,), (SymmetryAxis((0.0, 0.0, 1.0), (0.0, 0.0, 0.1)),))
    )
    written = header([item, OBJECTS[1]])
    data["rpl"] = written["rpl"]
    assert [found.symmetries for found in objects_from_coco(data)] == [item.symmetries, Symmetries()]
    validate_coco(data, source="x")
    data["rpl"]["objects"][0]["symmetries_continuous"][0]["axis"] = [0, 0, 0]
    with pytest.raises(DataError, match=r"object box: symmetries_continuous: .*0, 0, 0"):
        validate_coco(data, source="x")
