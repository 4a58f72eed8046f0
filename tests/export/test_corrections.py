"""Exports that were edited with another program: what was changed is found, and applied from then on."""

import json
from copy import deepcopy

import cv2
import numpy as np
import pytest
from labelled_scenes import BOX, CAN, LAST_FRAME, labelled_scene, two_boxes
from pycocotools import mask as masks

from rpl_data.export import ExportScene, export_coco
from rpl_data.export.corrections import Corrector
from rpl_data.export.edited import OurImage, compare
from rpl_data.export.split import SplitRule
from rpl_data.formats.datasets.coco import read_coco
from rpl_data.types import Correction, DataError
from rpl_data.workspace.correction_records import corrections_from_json, corrections_to_json

NAMES = {model.name: model.keypoints for model in (BOX, CAN)}
SQUARE = [60.0, 20.0, 90.0, 20.0, 90.0, 60.0, 60.0, 60.0]


@pytest.fixture
def scene(tmp_path):
    return labelled_scene(tmp_path / "recording", "desk")


@pytest.fixture
def data(scene, tmp_path):
    """The export as it is in the file; annotation 2k - 1 is the box in frame k, 2k the can."""
    return export(scene, tmp_path, [])


def export(scene, tmp_path, corrections):
    corrector = Corrector(corrections, [BOX, CAN])
    labels = [corrector.corrected(label) for label in scene.labels]
    corrected = ExportScene(scene.scene, scene.trajectory, labels)
    export_coco(tmp_path / "coco", [corrected], [BOX, CAN], split=SplitRule(val_fraction=0.0))
    return json.loads((tmp_path / "coco" / "train.json").read_text())


def ours(data):
    names = {category["id"]: category["name"] for category in data["categories"]}
    found = {}
    for image in data["images"]:
        here = [a for a in data["annotations"] if a["image_id"] == image["id"]]
        own = {(names[a["category_id"]], a.get("instance", "")): a for a in here}
        size = (image["height"], image["width"])
        found[image["scene"], image["frame"]] = OurImage(image["file_name"], size, own)
    return found


def compared(edited, data):
    return compare(deepcopy(edited), ours(data), NAMES, source="edited.json")


def edit(data):
    """A keypoint moved by 3, 4 px, another hidden, a mask drawn anew, an instance deleted, one ignored."""
    edited = deepcopy(data)
    box1, can1, box2, can2, box3 = edited["annotations"][:5]
    box1["keypoints"][3] += 3
    box1["keypoints"][4] += 4
    box1["keypoints"][8] = 1
    can1["segmentation"] = [SQUARE]
    box2["iscrowd"] = 1
    edited["annotations"].remove(can2)
    edited["annotations"].append(deepcopy(box3) | {"id": 99})
    edited["annotations"].append(deepcopy(box3) | {"id": 100, "image_id": 1})
    return edited


def as_others_write_it(data):
    """Only COCO's own keys, other ids, as text, other image folders, other order of categories."""
    image_keys, keys = ("file_name", "width", "height"), ("segmentation", "bbox", "keypoints", "iscrowd")
    tail = str.maketrans({"/": "\\"})
    return {
        "images": [
            {key: image[key] for key in image_keys}
            | {"id": str(image["id"] + 70), "file_name": "C:\\export\\" + image["file_name"].translate(tail)}
            for image in data["images"]
        ],
        "annotations": [
            {key: one[key] for key in keys}
            | {"id": str(900 + row), "image_id": str(one["image_id"] + 70)}
            | {"category_id": str(one["category_id"] + 3), "attributes": {"occluded": False}}
            for row, one in enumerate(data["annotations"])
        ],
        "categories": [
            {"id": "1", "name": "nobody uses it"},
            *({"id": str(c["id"] + 3), "name": c["name"]} for c in data["categories"][::-1]),
        ],
    }


@pytest.mark.parametrize("written", [lambda edited: edited, as_others_write_it])
def test_what_was_edited_is_found_and_nothing_else(data, written):
    found = compared(written(edit(data)), data)
    by_key = {(one.frame, one.object): one for one in found.corrections}
    u, v = data["annotations"][0]["keypoints"][3:5]
    x, y = data["annotations"][0]["keypoints"][6:8]
    assert by_key.keys() == {(1, "box"), (1, "can"), (2, "box"), (2, "can")}
    assert by_key[1, "box"].keypoints == {"b": (u + 3, v + 4, 2), "c": (x, y, 1)}
    assert by_key[1, "can"].mask is not None and not by_key[1, "can"].keypoints
    assert by_key[2, "box"] == Correction("desk", 2, "box", crowd=True)
    assert by_key[2, "can"] == Correction("desk", 2, "can", deleted=True)
    assert found.moved_px == pytest.approx([5.0, 0.0]) and 0 <= found.ious[0] < 1
    assert sorted(found.refused.values())[-2:] == [1, 1] and found.boxes == 0
    assert corrections_from_json(json.loads(json.dumps(corrections_to_json(found.corrections)))) == (
        found.corrections
    )
    assert compared(written(data), data).corrections == []


def test_the_next_export_is_corrected_and_all_else_is_as_it_was(scene, data, tmp_path):
    found = compared(edit(data), data)
    after = export(scene, tmp_path, found.corrections)
    assert after["images"] == data["images"]
    before = {(a["image_id"], a["category_id"]): a for a in data["annotations"]}
    now = {(a["image_id"], a["category_id"]): a | {"id": 0} for a in after["annotations"]}
    changed = {key for key in before if now.get(key) != before[key] | {"id": 0}}
    assert changed == {(2, 1), (2, 2), (3, 1), (3, 2)} and (3, 2) not in now
    assert [key for key, one in now.items() if one.get("corrected")] == [(2, 1), (2, 2), (3, 1)]
    assert all(one["camera_from_object"] == before[key]["camera_from_object"] for key, one in now.items())
    moved, drawn, ignored = now[2, 1], now[2, 2], now[3, 1]
    assert moved["keypoints"][3] == pytest.approx(before[2, 1]["keypoints"][3] + 3)
    assert moved["sigma_px"][1] is None and moved["segmentation"] == before[2, 1]["segmentation"]
    assert drawn["bbox"] == [60, 20, 30, 40] and drawn["area"] == 1200
    full = masks.decode(drawn["segmentation_full"])
    assert full[20:60, 60:90].all() and drawn["visib_fract"] == pytest.approx(1200 / full.sum())
    assert drawn["keypoints"] == before[2, 2]["keypoints"]
    assert ignored["iscrowd"] == 1
    back = read_coco(tmp_path / "coco" / "train.json")
    assert len(back["annotations"]) == len(data["annotations"]) - 2 and len(back["crowds"]) == 1


def test_what_an_export_did_is_said_and_what_no_longer_fits_too(scene, data):
    found = compared(edit(data), data)
    stray = [Correction("desk", LAST_FRAME, "box", keypoints={"gone": (1.0, 2.0, 2)})]
    corrector = Corrector([*found.corrections, *stray], [BOX, CAN])
    labels = [corrector.corrected(label) for label in scene.labels]
    assert labels[LAST_FRAME] == scene.labels[LAST_FRAME]
    done, poses, lost = corrector.messages()
    assert "1 mask changed, keypoints of 1 instance moved, 1 instance deleted, 1 instance marked" in done
    assert "may disagree" in poses and lost.startswith("1 correction from another program could not")
    assert Corrector([], [BOX, CAN]).messages() == []


def test_a_box_without_its_mask_and_a_plain_rle(data):
    edited = deepcopy(data)
    edited["annotations"][0]["bbox"][2] += 5
    mask = masks.decode(data["annotations"][1]["segmentation"])
    runs = np.diff(np.flatnonzero(np.diff(mask.T.ravel(), prepend=2, append=2)))
    counts = [0, *runs] if mask[0, 0] else runs
    edited["annotations"][1]["segmentation"] = {"size": list(mask.shape), "counts": [int(n) for n in counts]}
    found = compared(edited, data)
    assert found.corrections == [] and found.boxes == 1


def test_what_a_program_rounds_is_no_correction(data):
    """Masks turned into polygons through the centres of their outer pixels, keypoints into whole pixels."""
    edited = deepcopy(data)
    for one in edited["annotations"]:
        outlines, _ = cv2.findContours(
            masks.decode(one["segmentation"]), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        one["segmentation"] = [[float(number) for number in outline.ravel()] for outline in outlines]
        one["keypoints"] = [round(number) for number in one["keypoints"]]
    found = compared(edited, data)
    assert found.corrections == [] and found.redrawn == 10
    moved = edited["annotations"][0]
    moved["keypoints"][3] += 1
    moved["segmentation"][0] = [number + 2 for number in moved["segmentation"][0]]
    (one,) = compared(edited, data).corrections
    assert set(one.keypoints) == {"b"} and one.mask is not None


def drop(key):
    return lambda data: data.pop(key)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: d["images"][0].update(scene="attic"), "1 of its 6 images are not in export/coco"),
        (lambda d: d["images"].append(d["images"][0] | {"id": 77}), "holds an image twice"),
        (lambda d: d["images"][2].update(width=10), "10 x 120 pixels; ours has 160 x 120"),
        (lambda d: d["categories"][1].update(name="cup"), "category 'cup' is no object of this workspace"),
        (lambda d: d["categories"][1]["keypoints"].pop(), "keypoints of can are not those"),
        (lambda d: d["annotations"][0].update(image_id=77), "names an image or category it lacks"),
        (lambda d: d["annotations"][0]["camera_from_object"].__setitem__(3, 0.9), "its pose is another"),
        (lambda d: d["annotations"][0]["keypoints"].pop(), "box in images/desk/000001.png .* keypoints"),
        (lambda d: d["annotations"][0]["keypoints"].__setitem__(0, None), "not a finite number"),
        (lambda d: d["annotations"][0]["segmentation"].update(counts="P1"), "runs of a mask"),
        (lambda d: d["annotations"][0].update(segmentation=None), "neither polygons nor run lengths"),
        (lambda d: d["annotations"][0].update(segmentation=[[0] * 6]), "delete the instance instead"),
        (lambda d: d["annotations"][0]["keypoints"].__setitem__(3, -5000), r"b at \(-5000, .* outside of"),
        (lambda d: d["annotations"][0].update(bbox="all"), "damaged"),
        (drop("images"), "images"),
        (drop("annotations"), "annotations"),
    ],
)  # fmt: skip
def test_a_file_that_is_damaged_or_not_ours_is_refused(data, spoil, said):
    edited = deepcopy(data)
    spoil(edited)
    with pytest.raises(DataError, match=said) as refusal:
        compared(edited, data)
    assert str(refusal.value).startswith("edited.json") and "\n" not in str(refusal.value)


@pytest.mark.parametrize("written", [lambda edited: edited, as_others_write_it])
def test_an_instance_is_corrected_and_the_other_one_is_not(tmp_path, written):
    scene = two_boxes(tmp_path / "recording")
    data = export(scene, tmp_path, [])
    edited = deepcopy(data)
    first, second = edited["annotations"][:2]
    assert ("instance" in first, second["instance"]) == (False, "2")
    second["keypoints"][3] += 3
    edited["annotations"] = [second, *edited["annotations"][2:-1]]
    found = compared(written(edited), data)
    assert {(one.frame, one.instance): one.deleted for one in found.corrections} == {
        (1, ""): True,
        (1, "2"): False,
        (LAST_FRAME, "2"): True,
    }
    kept = corrections_from_json(json.loads(json.dumps(corrections_to_json(found.corrections))))
    again = export(scene, tmp_path, kept)["annotations"]
    assert [one.get("instance", "") for one in again] == ["2", *["", "2"] * (LAST_FRAME - 2), ""]
    assert again[0]["keypoints"] == second["keypoints"]
